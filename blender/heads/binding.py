"""Preparation of a mesh as a head: landmarks are bound and regions proposed, and both are stored with the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ...core.errors import HeadError, Message
from ...core.heads.bind import Binding, bind_landmarks
from ...core.heads.checks import EYES_SHUT, HOLLOW, Finding, check_head
from ...core.heads.landmark_vertices import TOO_COARSE
from ...core.heads.portrait import Paint
from ...core.heads.proposal import propose_regions
from ...core.heads.rig import Part, Skin
from ...core.numeric.arrays import FloatArray, IntArray
from ..characters import read_kinds
from ..frames import HEAD_TO_BLENDER
from ..meshes import (
    can_be_driven,
    driven_by_keys,
    eye_vertices,
    is_head,
    mesh_of,
    object_of,
    read_landmarks,
    read_regions,
    read_vertices,
    stored_integers,
    write_landmarks,
    write_regions,
)
from ..muting import animated_paths
from ..names import (
    COUNT_PROPERTY,
    KEYS_PROPERTY,
    MARKS_PROPERTY,
    PART_PROPERTY,
    REGION_GROUPS,
    SELECTION_PROPERTY,
)
from ..paint import read_paint
from ..work import Task, Work, do_at_once
from .family import face_candidates, family_of, heads_of, loose_companions, require_character
from .levels import without_copies
from .look_keys import take_back_look_keys
from .parts import (
    current_skin,
    forget_parts,
    held_by_head,
    is_sorted,
    named_others,
    open_border,
    skin_of_object,
    sort_character,
)
from .refining import on_brows, on_lids
from .soundness import generating_modifiers, require_sound, stray_vertices

_MAX_LOOSE = 3
"""Loose meshes beside a character in which a face is sought."""
_UPRIGHT = np.cos(np.radians(20.0))
"""Cosine of the angle to -Y above which a mesh is rotated; a smaller angle is the pose of the head."""
_ROTATIONS = "rotation_euler", "rotation_quaternion", "rotation_axis_angle"
_Rotation: TypeAlias = NDArray[np.floating[Any]]
"""A rotation matrix (3, 3)."""
CACHES = {"MESH_CACHE", "MESH_SEQUENCE_CACHE"}


class VertexTakenError(HeadError):
    """Raised if another landmark is bound to the vertex."""


def bind_character(obj: bpy.types.Object | None) -> tuple[bpy.types.Object, Binding]:
    """Find the face of a character at once; parameter, result and errors are those of `search_character`."""
    return do_at_once(search_character(obj))


def bind_head(obj: bpy.types.Object | None) -> Binding:
    """Find the face of a mesh at once; parameter, result and errors are those of `search_head`."""
    return do_at_once(search_head(obj))


def search_character(obj: bpy.types.Object | None) -> Work[tuple[bpy.types.Object, Binding]]:
    """Find the face of the character to which `obj` belongs, and bind its landmarks as `search_head` does.

    A mesh with marked points, or the head that is bound already, is taken; otherwise the most likely mesh. Returns the
    mesh with the skin of the face, and the binding. Raises HeadError as `search_head` does, for `obj` or the most
    likely mesh.
    """
    given = obj = require_character(obj)
    if len(bound := heads_of([obj])) == 1:
        obj = bound[0]
    if driven_by_keys(obj):
        take_back_look_keys(obj)
        forget_parts(obj)
        del mesh_of(obj)[KEYS_PROPERTY]
    family = [member for member in (given, *family_of(obj)) if member.type == "MESH"]
    marked = [member for member in family if read_marks(mesh_of(member))]
    known = marked or [member for member in family if is_head(member)]
    if known:
        return known[0], (yield from search_head(known[0]))
    failures: dict[bpy.types.Object, HeadError] = {}
    likely = without_copies(face_candidates(obj))
    for candidate in dict.fromkeys([*likely, *loose_companions(obj)[:_MAX_LOOSE]]):
        try:
            return candidate, (yield from search_head(candidate))
        except HeadError as error:
            failures[candidate] = error
    raise failures.get(given) or next(iter(failures.values()))


def search_head(obj: bpy.types.Object | None) -> Work[Binding]:
    """Find the landmarks of `obj`, with or without marked points, propose its regions, and sort the parts of its face.

    Without marks the face is searched along the axes of the scene, first upright towards -Y, as importers rotate the
    object rather than its vertices. Then it is searched along the object's own axes, as the object may be rotated by
    any angle. If the vertices are not upright, they are rotated, and the object is rotated back, so that nothing moves
    in the scene. Parts that were sorted before are not changed. Raises HeadError if no face is found, or the mesh would
    have to be rotated and `turn_mesh` cannot do this.
    """
    mesh, obj = mesh_of(obj), object_of(obj)
    require_sound(obj)
    scene_axes = HEAD_TO_BLENDER.T @ np.array(obj.matrix_world.to_quaternion().to_matrix()) @ HEAD_TO_BLENDER
    others = read_kinds(mesh) != Part.SKIN if is_sorted(obj) else named_others(obj)
    others[eye_vertices(obj)] = True
    others |= stray_vertices(obj)
    marks, paint = read_marks(mesh), read_paint(obj)
    aligned = np.allclose(scene_axes, np.eye(3), atol=1e-3)
    axes = [scene_axes] if marks or aligned else [scene_axes, np.eye(3)]
    try:
        binding, along, skin = yield from _found(obj, others, paint, marks, axes)
    except HeadError as error:
        if names := ", ".join(generating_modifiers(obj, coarse=str(error) == TOO_COARSE)):
            raise HeadError(
                "No face was found on {name} without its modifiers: {names}. Apply them, and find the face again.",
                name=obj.name,
                names=names,
            ) from error
        raise
    upright = along if _is_small(binding.rotation) else binding.rotation @ along
    turn = None if _is_small(upright) else HEAD_TO_BLENDER @ upright @ HEAD_TO_BLENDER.T
    if turn is not None:
        turn_mesh(obj, turn)
    try:
        binding, landmarks = yield from _among_parts(obj, binding, skin, paint, others, marks)
    except (HeadError, GeneratorExit):  # another mesh of the character may have the face, or the user stops
        if turn is not None:
            turn_mesh(obj, turn.T)
        raise
    landmarks, seen = on_lids(obj, landmarks, binding.rotation, marks)
    if seen:  # the tracker may take blank eyeballs, as of a mesh without colours, for shut lids
        binding = replace(binding, findings=tuple(found for found in binding.findings if found != EYES_SHUT))
    landmarks = on_brows(obj, landmarks, binding.rotation)
    write_landmarks(mesh, landmarks)
    if SELECTION_PROPERTY in mesh:
        del mesh[SELECTION_PROPERTY]
    propose_head_regions(obj)
    return binding


def _found(
    obj: bpy.types.Object, others: NDArray[np.bool_], paint: Paint | None, marks: dict[int, int], axes: list[_Rotation]
) -> Work[tuple[Binding, _Rotation, Skin]]:
    """Return what `_bound` does for `obj` without `others`, and its skin.

    A head that is not at the top of its body, or small on it, is found by its bone; all else then counts as `others`.
    """
    skin = skin_of_object(obj, others)
    try:
        return *(yield from _bound(obj, skin, paint, marks, axes)), skin
    except HeadError:
        if marks or (held := held_by_head(obj)) is None:
            raise
    others |= ~held
    skin = skin_of_object(obj, others)
    return *(yield from _bound(obj, skin, paint, marks, axes)), skin


def _among_parts(
    obj: bpy.types.Object,
    binding: Binding,
    skin: Skin,
    paint: Paint | None,
    others: NDArray[np.bool_],
    marks: dict[int, int],
) -> Work[tuple[Binding, NDArray[np.intp]]]:
    """Sort the parts of the face of `obj`, and search again without those that are not skin.

    Returns the binding and the vertex of each landmark, (66,). If no face is found this time, the parts are forgotten.
    """
    mesh, landmarks = mesh_of(obj), skin.kept[binding.landmarks]
    if not is_sorted(obj) and not any(PART_PROPERTY in child for child in obj.children):
        weights = propose_regions(read_vertices(mesh)[skin.kept], skin.faces, binding.landmarks)
        sort_character(obj, landmarks, weights, skin)
    others |= read_kinds(mesh) != Part.SKIN
    final = skin_of_object(obj, others, landmarks)
    if len(final.kept) == len(skin.kept):
        return binding, landmarks
    try:
        binding, _ = yield from _bound(obj, final, paint, marks, [np.eye(3)])
    except (HeadError, GeneratorExit):
        forget_parts(obj)
        raise
    return binding, final.kept[binding.landmarks]


def propose_head_regions(obj: bpy.types.Object) -> None:
    """Replace the weights of the regions of `obj` with those derived from its landmarks."""
    write_regions(obj, proposed_weights(obj, read_landmarks(obj)))


def proposed_weights(obj: bpy.types.Object, landmarks: IntArray) -> FloatArray:
    """Return the weights, (3, V), of regions that follow from (66,) landmarks of `obj`."""
    skin = current_skin(obj)
    weights = np.zeros((len(REGION_GROUPS), len(skin.number)))
    own = skin.number >= 0
    known = propose_regions(read_vertices(mesh_of(obj))[skin.kept], skin.faces, skin.number[landmarks])
    weights[:, own] = known[:, skin.number[own]]
    return weights


def check_object(obj: bpy.types.Object | None) -> list[Finding]:
    """Check `obj` for problems; raises HeadError if it has no regions, or no landmarks on its skin."""
    mesh, obj = mesh_of(obj), object_of(obj)
    landmarks, weights, skin = read_landmarks(obj), read_regions(obj), current_skin(obj)
    found = check_head(read_vertices(mesh)[skin.kept], skin.faces, skin.number[landmarks], weights[:, skin.kept])
    return [*found, HOLLOW] if len(open_border(obj)) else found


def missing_parts(obj: bpy.types.Object) -> list[tuple[str, str]]:
    """Return what the mesh `obj` still lacks: a sentence, and the operator that adds it.

    Only names are examined, which is fast enough for drawing a panel; `check_object` examines the mesh itself.
    """
    mesh = mesh_of(obj)
    if not can_be_driven(obj):
        return [(Message("This mesh has no landmarks yet"), "facemime.bind_landmarks")]
    if (bound_at := stored_integers(mesh, COUNT_PROPERTY)) is not None and not np.array_equal(
        bound_at, len(mesh.vertices)
    ):
        return [(Message("The vertex count has changed since the face was found"), "facemime.bind_landmarks")]
    if not driven_by_keys(obj) and any(name not in obj.vertex_groups for name in REGION_GROUPS):
        return [(Message("This mesh has no regions yet"), "facemime.propose_regions")]
    return []


def read_marks(mesh: bpy.types.Mesh) -> dict[int, int]:
    """Return the marked points: iBUG number to vertex index."""
    flat = stored_integers(mesh, MARKS_PROPERTY)
    if flat is None or flat.ndim != 1 or len(flat) % 2:
        return {}
    return dict(flat.reshape(-1, 2).tolist())


def write_marks(mesh: bpy.types.Mesh, marks: dict[int, int]) -> None:
    """Store the marked points: iBUG number to vertex index; none clears them."""
    if marks:
        mesh[MARKS_PROPERTY] = [value for pair in marks.items() for value in pair]
    elif MARKS_PROPERTY in mesh:
        del mesh[MARKS_PROPERTY]


def selected_vertex(obj: bpy.types.Object) -> int:
    """Return the single vertex selected in Edit Mode; raises HeadError unless exactly one is selected."""
    obj.update_from_editmode()
    selected = np.empty(len(mesh_of(obj).vertices), dtype=bool)
    mesh_of(obj).vertices.foreach_get("select", selected)
    if selected.sum() != 1:
        raise HeadError(
            "{selected} vertices are selected. Select a single one in Edit Mode.", selected=int(selected.sum())
        )
    return int(np.flatnonzero(selected)[0])


def move_landmark(obj: bpy.types.Object, landmark: int, vertex: int) -> None:
    """Bind a landmark, an index in the 66, to another vertex; raises VertexTakenError if that has another landmark."""
    landmarks = read_landmarks(obj)
    taken = np.flatnonzero(landmarks == vertex)
    if len(taken) and taken[0] != landmark:
        raise VertexTakenError("Another landmark is bound to this vertex. Select a different vertex.")
    landmarks[landmark] = vertex
    write_landmarks(mesh_of(obj), landmarks)


def _bound(
    obj: bpy.types.Object, skin: Skin, paint: Paint | None, marks: dict[int, int], axes: list[_Rotation]
) -> Work[tuple[Binding, _Rotation]]:
    """Return the binding of the skin of `obj`, and the one of `axes`, (3, 3) rotations, along which it was found.

    It is the first along which a face is clearly visible, or otherwise the one along which the template was deformed
    least. Raises HeadError if no face is found along any of them.
    """
    found: list[tuple[Binding, _Rotation]] = []
    failure: HeadError | None = None
    marked = {landmark: int(skin.number[vertex]) for landmark, vertex in marks.items() if vertex < len(skin.number)}
    marked = {landmark: vertex for landmark, vertex in marked.items() if vertex >= 0}
    shown = None if paint is None else paint.of_skin(skin)
    vertices = read_vertices(mesh_of(obj))
    for rotation in axes:
        try:
            turned = vertices[skin.kept] @ rotation.T
            binding = yield Task(
                partial(bind_landmarks, turned, skin.faces, marked, shown), len(found) / (len(axes) + 1)
            )
        except HeadError as error:
            failure = error
            continue
        found.append((binding, rotation))
        if binding.sure:
            break
    if not found:
        assert failure is not None
        raise failure
    return min(found, key=lambda pair: pair[0].strain)


def _is_small(rotation: _Rotation) -> bool:
    return bool((np.trace(rotation) - 1.0) / 2.0 >= _UPRIGHT)


def placements() -> dict[bpy.types.Object, Matrix]:
    """Return the world matrix of each mesh object of the view layer."""
    bpy.context.view_layer.update()
    return {obj: obj.matrix_world.copy() for obj in bpy.context.view_layer.objects if obj.type == "MESH"}


def turn_note(head: bpy.types.Object, before: Mapping[bpy.types.Object, Matrix]) -> str:
    """Say that `head` was rotated since its world matrix was as in `before`; "" if it was not."""
    if before.get(head) in (None, head.matrix_world):
        return ""
    return Message(
        "{name}: the vertices now face -Y, and the object is rotated instead; it looks the same", name=head.name
    )


def turn_mesh(obj: bpy.types.Object, rotation: _Rotation) -> None:
    """Rotate the vertices of `obj`, in Blender's axes, and the object back, so that nothing moves in the scene.

    Raises HeadError if the vertices come from a file, other objects share the mesh, or the rotation of the object is
    animated or constrained.
    """
    if any(modifier.type in CACHES for modifier in obj.modifiers):
        raise HeadError(
            "The vertices of {name} come from a file, so they cannot be rotated to face -Y. Export it facing -Y.",
            name=obj.name,
        )
    if mesh_of(obj).users > 1:
        raise HeadError(
            "The mesh of {name} has to be rotated to face -Y, but other objects share it. Make it single-user.",
            name=obj.name,
        )
    if animated_paths(obj, _ROTATIONS) or any(not constraint.mute for constraint in obj.constraints):
        raise HeadError(
            "The mesh of {name} has to be rotated to face -Y, but the object's rotation is animated or "
            "constrained. Remove the animation or the constraint first.",
            name=obj.name,
        )
    turn = Matrix(rotation.tolist()).to_4x4()
    mesh_of(obj).transform(turn, shape_keys=True)
    obj.matrix_world = obj.matrix_world @ turn.inverted()
    for child in obj.children:
        child.matrix_parent_inverse = turn @ child.matrix_parent_inverse
    bpy.context.view_layer.update()  # otherwise its bounding box is that of before
