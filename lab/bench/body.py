"""A whole character with a body, bones, eyes and teeth of MakeHuman's base mesh, which is CC0.

`python -m lab.bench.body FILE.blend` writes it to a file.

Its topology, bones and weights are those of MPFB's default rig, as characters of MakeHuman have them; the face is of a
person whose head does not ship. Unlike the other characters of the benchmark, pictures of it may be shown.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.blender.frames import to_blender
from facemime.core.files.assets import ASSETS
from lab.training.head.anatomy import landmark_vertices
from lab.training.head.build import TO_HEAD, head_points
from lab.training.head.complexion import MAN
from lab.training.head.identity import Identity
from lab.training.head.occlusion import openness
from lab.training.head.organs import encode
from lab.training.head.parts import build_parts, jaw_hinge
from lab.training.head.skin import paint_skin
from lab.training.head.source import BaseMesh, Source, open_source

_BELOW_CHIN, _BESIDE = 0.09, 0.14
"""Distances in metres from the chin and from the middle within which the skin is painted; clothes cover the rest."""
_SUIT = (0.10, 0.13, 0.19)
_LOOK = replace(
    MAN,
    tone=(0.47, 0.31, 0.225),
    blood=(0.46, 0.25, 0.19),
    bright=(0.56, 0.385, 0.29),
    lip=(0.43, 0.245, 0.215),
    lip_dark=(0.24, 0.12, 0.11),
    hair=(0.05, 0.04, 0.035),
    beard=0.8,
)
_FACE = Identity(
    gender=1.0,
    age=0.35,
    muscle=0.75,
    weight=0.6,
    origins={"african": 1.0},
    details={"head/head-square": 0.4, "nose/nose-scale-horiz-incr": 0.2},
)
_BONES = {"eye_left": "eye.L", "eye_right": "eye.R", "teeth_upper": "head", "teeth_lower": "jaw", "tongue": "jaw"}

Points = NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """The character in the scene.

    Attributes
    ----------
    skin : bpy.types.Object
        The body.
    keys : dict of str to (V, 3) float64
        Motion of its vertices under ARKit's expressions: head frame, metres.
    """

    skin: bpy.types.Object
    keys: Mapping[str, Points]


def main() -> int:
    """Write the character; return the exit status."""
    command = argparse.ArgumentParser(description="Write a whole character of MakeHuman to a file.")
    command.add_argument("output", type=Path, metavar="FILE.blend")
    output = command.parse_args().output.resolve()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    add_body()
    bpy.ops.wm.save_as_mainfile(filepath=str(output), compress=True)
    return 0


def add_body() -> Body:
    """Add the character to the open file, standing on the ground. Painting its skin takes a minute."""
    source = open_source()
    base = source.base_mesh()
    points = head_points(source, base, _FACE)
    places = to_blender(points).astype(np.float64)
    body = _Group.of(base, "body")
    ground = (0.0, 0.0, places[body.vertices, 2].min())
    places -= ground
    rig = _add_rig(source, base, places)
    skin = _add(rig, "Body", places[body.vertices], body.faces, _skin(base, body, points), body.uv)
    suit = _Group.of(base, "helper-tights")
    clothes = _add(rig, "Suit", places[suit.vertices], suit.faces, _material("Suit", _SUIT), suit.uv)
    for bone, weights in source.weights().items():
        for obj, group in ((skin, body), (clothes, suit)):
            _weigh(obj, bone, [(int(group.number[v]), w) for v, w in weights if group.number[v] >= 0])
    names = source.unit_names()
    units = [source.unit(name) * TO_HEAD for name in names]
    hinge = jaw_hinge(base, points, units[names.index("jawOpen")])
    for part in build_parts(base, points, units, names.index("tongueOut"), hinge, names, units):
        image = ASSETS / "head" / f"{part.name.split('_')[0]}.jpg"
        vertices = to_blender(part.vertices) - ground
        obj = _add(rig, part.name, vertices, part.faces, _material(part.name, (0.8, 0.8, 0.8), image), part.uv)
        _weigh(obj, _BONES[part.name], [(vertex, 1.0) for vertex in range(len(vertices))])
    return Body(skin, {name: unit[body.vertices] for name, unit in zip(names, units, strict=True)})


@dataclass(frozen=True)
class _Group:
    """A group of faces of the base mesh: its vertices, their new numbers or -1, faces (f, 4), and uv (f, 4, 2)."""

    vertices: NDArray[np.intp]
    number: NDArray[np.intp]
    faces: NDArray[np.intp]
    uv: Points

    @classmethod
    def of(cls, base: BaseMesh, name: str) -> _Group:
        rows = base.groups == name
        faces = base.faces[rows]
        vertices = np.unique(faces[faces >= 0])
        number = np.full(len(base.vertices) + 1, -1)  # the last one is for the missing corner of a triangle
        number[vertices] = np.arange(len(vertices))
        return cls(vertices, number[:-1], number[faces], base.uv[base.face_uv[rows]])


def _add_rig(source: Source, base: BaseMesh, places: Points) -> bpy.types.Object:
    joints = {name: places[np.unique(base.faces[base.groups == name])].mean(axis=0) for name in set(base.groups)}
    rig = bpy.data.objects.new("MakeHuman", bpy.data.armatures.new("MakeHuman"))
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bones, described = rig.data.edit_bones, source.rig()
    for name, bone in described.items():
        new = bones.new(name)
        new.head, new.tail = (_end(bone[end], joints, places) for end in ("head", "tail"))
        new.roll = bone["roll"]
    for name, bone in described.items():
        bones[name].parent = bones.get(bone["parent"] or "")
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def _end(end: Mapping[str, object], joints: Mapping[str, Points], places: Points) -> Points:
    """Place of an end of a bone: a joint's cube, a vertex, or the mean of several."""
    if end["strategy"] == "CUBE":
        return joints[str(end["cube_name"])]
    vertices = end["vertex_index"] if end["strategy"] == "VERTEX" else end["vertex_indices"]
    return np.asarray(places[np.atleast_1d(np.asarray(vertices))].mean(axis=0))


def _add(
    rig: bpy.types.Object,
    name: str,
    vertices: Points,
    faces: NDArray[np.intp],
    material: bpy.types.Material,
    uv: Points,
) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], [[int(v) for v in face if v >= 0] for face in faces])
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
    mesh.uv_layers.new().data.foreach_set("uv", uv[faces >= 0].astype(np.float32).ravel())
    mesh.materials.append(material)
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    obj.parent = rig
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    return obj


def _weigh(obj: bpy.types.Object, bone: str, weights: list[tuple[int, float]]) -> None:
    if weights:
        group = obj.vertex_groups.new(name=bone)
        for vertex, weight in weights:
            group.add([vertex], weight, "REPLACE")


def _material(name: str, colour: tuple[float, float, float], image: Path | None = None) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.diffuse_color = (*colour, 1.0)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    if image is not None:
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(str(image))
        texture.image.pack()
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        nodes.active = texture
    return material


def _skin(base: BaseMesh, body: _Group, points: Points) -> bpy.types.Material:
    """Paint the head as the shipped heads are painted, in the layout of the base mesh."""
    landmarks = points[landmark_vertices(base.mirror)]
    corners = points[body.vertices][body.faces]
    seen = (corners[..., 1] < landmarks[8, 1] + _BELOW_CHIN) & (np.abs(corners[..., 0]) < _BESIDE)
    faces = body.vertices[body.faces[seen.all(axis=1)]]
    head, places = np.unique(faces, return_inverse=True)
    faces = places.reshape(faces.shape)
    left = np.flatnonzero(points[head, 0] >= 0.0)
    shade = np.zeros(len(base.vertices))
    shade[head[left]] = openness(points[head], faces, left)
    shade[base.mirror[head[left]]] = shade[head[left]]
    image = paint_skin(
        points[head],
        faces,
        body.uv[seen.all(axis=1)],
        np.zeros(len(faces), dtype=np.int64),
        np.stack([shade[head], np.zeros(len(head))], axis=1),
        points,
        landmarks,
        _LOOK,
    )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "skin.jpg"
        path.write_bytes(encode(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), 90))
        return _material("Skin", _LOOK.tone, path)


if __name__ == "__main__":
    sys.exit(main())
