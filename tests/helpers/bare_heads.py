"""Meshes without landmarks, and where their landmarks are found."""

import bpy
import numpy as np

from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks, read_vertices
from facemime.blender.names import COUNT_PROPERTY, LANDMARKS_PROPERTY
from facemime.core.face.landmarks import OUTER_EYE_CORNERS


def bare_head() -> bpy.types.Object:
    """Add the mesh of the built-in head without landmarks and regions."""
    obj = add_head(bpy.context)
    for name in (LANDMARKS_PROPERTY, COUNT_PROPERTY):
        del obj.data[name]
    obj.vertex_groups.clear()
    return obj


def off(obj: bpy.types.Object, landmarks: np.ndarray) -> np.ndarray:
    """Return (66,) distances of the landmarks of `obj` from the vertices `landmarks`, in outer-eye distances."""
    vertices = read_vertices(obj.data)
    unit = np.linalg.norm(np.subtract(*vertices[landmarks[OUTER_EYE_CORNERS]]))
    return np.linalg.norm(vertices[read_landmarks(obj)] - vertices[landmarks], axis=1) / unit


def in_scene(obj: bpy.types.Object) -> np.ndarray:
    """Return (V, 3) places of the vertices of `obj` in the scene."""
    return np.array([obj.matrix_world @ v.co for v in obj.data.vertices])


def pick(obj: bpy.types.Object, vertex: int) -> None:
    """Select a single vertex in Edit Mode, as a click does."""
    if obj.mode != "EDIT":
        bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.data.vertices[vertex].select = True
    bpy.ops.object.mode_set(mode="EDIT")
