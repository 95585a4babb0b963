"""Small FaceGen files, written byte by byte according to the specification of the format."""

import struct

import numpy as np

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5], [2, 0, 1]], np.float32)
TRIANGLES = np.array([[1, 4, 2]], np.int32)
QUADS = np.array([[0, 1, 2, 3]], np.int32)
UVS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.25]], np.float32)
DIFFERENCE = np.array([[1, -2, 3], [0, 0, 0], [100, 0, 0], [0, -100, 0], [7, 7, 7]], np.int16)
TARGETS = np.array([[5, 5, 5], [6, 6, 6], [7, 7, 7]], np.float32)
STATISTICAL = {"Wide": [3, 0], "Deep": [4]}


def text(value: str) -> bytes:
    return struct.pack("<i", len(value) + 1) + value.encode() + b"\0"


def tri(labels: bool = False, per_vertex_uv: bool = False) -> bytes:
    """A `.tri` with one difference and two statistical morphs."""
    header = [5, 1, 1, 1 if labels else 0, 1 if labels else 0, 0 if per_vertex_uv else 5, 1, 1, 2, 3, 0, 0, 0, 0]
    out = b"FRTRI003" + struct.pack("<14i", *header)
    out += VERTICES.tobytes() + TARGETS.tobytes() + TRIANGLES.tobytes() + QUADS.tobytes()
    if labels:
        out += struct.pack("<i", 3) + text("nose") + struct.pack("<i3f", 0, 1, 0, 0) + text("cheek")
    out += UVS.tobytes()
    if not per_vertex_uv:
        out += TRIANGLES.tobytes() + QUADS.tobytes()
    out += text("Smile") + struct.pack("<f", 0.01) + DIFFERENCE.tobytes()
    for name, rows in STATISTICAL.items():
        out += text(name) + struct.pack("<i", len(rows)) + np.array(rows, np.int32).tobytes()
    return out


def egm(vertices: int = 8) -> bytes:
    """An `.egm` with two symmetric modes and one asymmetric; FaceGen counts vertices of statistical morphs, too."""
    modes = np.arange(3 * vertices * 3, dtype=np.int16).reshape(3, vertices, 3)
    out = b"FREGM002" + struct.pack("<3iI10i", vertices, 2, 1, 2001060901, *[0] * 10)
    return out + b"".join(struct.pack("<f", 0.5) + mode.tobytes() for mode in modes)


OBJ = """# a quad, a triangle and a pentagon
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0.5
v 2 0 1
vt 0 0
vt 1 0
vt 1 1
f 1/1 2/2 3/3 4/1
f -4/1/1 5/2/1 3/3/1
f 1/1 2/1 5/1 3/1 4/1
"""


def export_tri(path: str) -> None:
    """Write the mesh of the scene with most vertices as a `.tri` without texture and morphs."""
    import bpy

    mesh = max((obj.data for obj in bpy.context.scene.objects if obj.type == "MESH"), key=lambda m: len(m.vertices))
    corners = [tuple(polygon.vertices) for polygon in mesh.polygons]
    triangles, quads = ([face for face in corners if len(face) == count] for count in (3, 4))
    vertices = np.array([vertex.co[:] for vertex in mesh.vertices], np.float32)
    upright = 1000.0 * vertices[:, [0, 2, 1]] * np.float32([1, 1, -1])
    header = struct.pack("<14i", len(vertices), len(triangles), len(quads), *[0] * 11)
    faces = np.array(triangles, np.int32).tobytes() + np.array(quads, np.int32).tobytes()
    with open(path, "wb") as file:
        file.write(b"FRTRI003" + header + upright.tobytes() + faces)
