"""Eyeballs that turn, in place of eyes that are painted on a mesh, such as those of a FaceGen head or a scan."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from mathutils import Vector

from ...core.errors import HeadError
from ...core.face.landmarks import OUTER_EYE_CORNERS
from ...core.face.rotation import euler_to_matrix
from ...core.heads.built_in import HeadPart, load_head
from ...core.heads.eyeballs import EYES, LID_THICKNESS, fit_eyeball
from ...core.numeric.arrays import FloatArray
from ..frames import to_blender
from ..meshes import eye_vertices, mesh_of, object_of, read_landmarks, read_vertices
from ..names import PARTS_PROPERTY
from .attached import attach
from .cutting import edited, move
from .materials import eye_material
from .new_heads import add_part

_MOST_ASIDE = 0.5
"""Sine of the largest angle by which an eyeball at rest looks aside."""
_BEHIND = 0.8
"""Size of the surface that was cut out relative to before, so that it lies behind the eyeball."""


def put_eyeballs(obj: bpy.types.Object | None) -> int:
    """Put an eyeball of the built-in head behind the lids of each eye that `open_eyes` has cut out, as a child.

    The painted surface moves behind it. Returns the number of eyeballs; raises HeadError if no eye was cut out.
    """
    obj, mesh = object_of(obj), mesh_of(obj)
    cut, vertices = eye_vertices(obj), read_vertices(mesh).astype(np.float64)
    right, left = vertices[read_landmarks(obj)[OUTER_EYE_CORNERS]]
    leftwards = (vertices[cut] - (right + left) / 2.0) @ (left - right) >= 0.0
    sides = {name: cut[leftwards == (name == "eye_left")] for name in ("eye_right", "eye_left")}
    sides = {name: rows for name, rows in sides.items() if len(rows) > 3}
    if not sides:
        raise HeadError("No eye was cut out of the skin. Open the eyes first.")
    spheres = {name: fit_eyeball(vertices[rows]) for name, rows in sides.items()}
    with edited(mesh) as work:
        every = list(work.verts)
        for name, rows in sides.items():
            centre = Vector(to_blender(spheres[name][:3]).tolist())
            for vertex in (every[row] for row in rows.tolist()):
                move(work, vertex, (_BEHIND - 1.0) * (vertex.co - centre))
    material = eye_material()
    collection = obj.users_collection[0] if obj.users_collection else bpy.context.scene.collection
    corners = vertices[read_landmarks(obj)]
    parts = {}
    for eye, name in zip(EYES, ("eye_right", "eye_left"), strict=True):
        if name in spheres:
            middle = corners[eye[[0, 3]]].mean(axis=0)
            parts[name] = add_part(collection, obj, _eyeball(name, spheres[name], middle), material)
    known = obj.get(PARTS_PROPERTY)
    attach(obj, (known.to_dict() if hasattr(known, "to_dict") else {}) | parts)
    return len(parts)


def _eyeball(name: str, sphere: FloatArray, middle: FloatArray) -> HeadPart:
    """The built-in eyeball of that name within a sphere of lids, (4,), which looks through the middle of its opening.

    The sphere behind painted lids, which are flat and deeper at the temple, lies nearer to the nose than an eye does.
    """
    part = load_head().part(name)
    offsets = part.vertices - part.pivot
    radius = float(np.linalg.norm(offsets, axis=1).max())
    across, down = np.clip((middle - sphere[:3])[:2] / sphere[3], -_MOST_ASIDE, _MOST_ASIDE)
    turn = euler_to_matrix(float(np.arcsin(down)), float(-np.arcsin(across)), 0.0)
    centre = sphere[:3].astype(np.float32)
    scaled = (1.0 - LID_THICKNESS) * sphere[3] / radius * offsets @ turn.T
    return replace(part, vertices=centre + scaled.astype(np.float32), pivot=centre)
