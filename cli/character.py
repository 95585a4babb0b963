"""`facemime bind` inside Blender: open or import a character, bind it, and save it with a picture of its landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, replace
from math import floor, log10
from pathlib import Path

import bpy
import cv2
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from numpy.typing import NDArray

from ..blender.animation.clips import clips_of, owners_of, play
from ..blender.animation.sampling import Sampling
from ..blender.characters import part_table, read_bones
from ..blender.contexts import evaluated_depsgraph, scene_of, showing_scene
from ..blender.heads.binding import check_object, write_marks
from ..blender.heads.expression_keys import MadeKeys, make_expression_keys
from ..blender.heads.family import armature_of, character_of, family_of
from ..blender.heads.keyed import driven_by_its_keys, known_set
from ..blender.meshes import driven_by_keys, is_head, mesh_of, object_of, read_landmarks
from ..blender.preview_scene import face_points, setup_preview
from ..blender.rendering import render_frames
from ..blender.view_layers import revealed, set_for_now
from ..core.bake.key_sets import KeySet
from ..core.errors import HeadError
from ..core.face.landmarks import EDGES, from_ibug
from ..core.files.capture import write_image
from ..core.heads.bind import Binding
from ..core.heads.key_presets import ESSENTIAL
from ..core.heads.rig import PART_NAMES
from ..core.numeric.arrays import FloatArray
from ..core.puppet.job import HeadFile
from ..core.rigs.control_names import role_of
from ..core.rigs.rig_map import RigMap
from ..core.takes.take import Take
from .character_files import (
    CUTS,
    bound_by_keys,
    bound_character,
    choose_level,
    likely_mesh,
    object_named,
    open_file,
    open_head,
    prepare_imported,
    read_from,
    set_frames,
    tell_of_lost_images,
)
from .console import Progress, tell
from .headless import AVATAR_SIDE, learn, save_blend
from .stopping import STOPPING

_LINE = (80, 220, 80)
_POINT = (255, 255, 255)
_NO_MARKS: Mapping[int, Mark] = {}


def draw_landmarks(scene: bpy.types.Scene, head: bpy.types.Object, side: int) -> NDArray[np.uint8]:
    """Render a face from the front, with the landmarks drawn over it if it has some, as BGR (side, side, 3).

    A preview camera is added to the scene.
    """
    setup_preview(scene, head, (side, side))
    (picture,) = render_frames(scene, np.array([float(scene.frame_current)]), (side, side))
    if not is_head(head):
        return picture
    points = face_points(head)[read_landmarks(head)]
    camera = object_of(scene.camera)
    seen = [world_to_camera_view(scene, camera, Vector(point)) for point in points]
    pixels = [(round(place.x * side), round((1.0 - place.y) * side)) for place in seen]
    drawn = np.ascontiguousarray(picture)
    for a, b in EDGES:
        cv2.line(drawn, pixels[a], pixels[b], _LINE, 1, cv2.LINE_AA)
    for pixel in pixels:
        cv2.circle(drawn, pixel, 2, _POINT, -1, cv2.LINE_AA)
    return np.asarray(drawn, dtype=np.uint8)


Mark = int | tuple[float, float, float]
"""A vertex, or a position in the scene."""
_REACH = 0.1
"""Largest distance of a position from the mesh, as a share of the mesh's diagonal."""
_PRECISION = 1e-5
"""Precision of positions, as a share of the mesh's size, which distinguishes vertices of a body with 280,000."""


def mark_points(obj: bpy.types.Object, marks: Mapping[int, Mark]) -> bpy.types.Object:
    """Mark points of a face, and return the mesh on which they are.

    Marked vertices belong to `obj`. Positions mark the mesh of its character that is nearest to them. Raises HeadError
    if there is no such vertex, or a position is not on the mesh.
    """
    chosen = {number: mark for number, mark in marks.items() if isinstance(mark, int)}
    positions = {number: np.array(mark) for number, mark in marks.items() if not isinstance(mark, int)}
    if positions and not chosen:
        obj = min(family_of(obj), key=lambda mesh: float(_distances(mesh, positions).min(axis=1).sum()))
    count = len(mesh_of(obj).vertices)
    for number, vertex in chosen.items():
        if not 0 <= vertex < count:
            raise HeadError(
                "Point {number} cannot be vertex {vertex}: {name} has {count} vertices, from 0.",
                number=number,
                vertex=vertex,
                name=obj.name,
                count=count,
            )
    away = _distances(obj, positions)
    size = float(np.linalg.norm(np.ptp(_in_scene(obj), axis=0)))
    for number, distances in zip(positions, away, strict=True):
        if distances.min() > _REACH * size:
            raise HeadError(
                "Point {number} is {distance:.3g} m away from {name}. Use Blender's coordinates, with Z up.",
                number=number,
                distance=distances.min(),
                name=obj.name,
            )
        chosen[number] = int(distances.argmin())
    write_marks(mesh_of(obj), chosen)
    return obj


def _in_scene(obj: bpy.types.Object) -> FloatArray:
    """Return the vertices of a mesh, (V, 3), where they are seen in the scene: in the pose of the current frame.

    Modifiers that change the number of vertices are left out.
    """
    with ExitStack() as stack:
        stack.enter_context(showing_scene(scene_of(obj)))
        stack.enter_context(nullcontext() if obj.visible_get() else revealed([obj]))
        for modifier in obj.modifiers if _count(obj) != len(mesh_of(obj).vertices) else ():
            before = _count(obj)
            with ExitStack() as hidden:
                set_for_now(hidden, modifier, "show_viewport", False)
                if _count(obj) != before:
                    stack.push(hidden.pop_all())
        return face_points(obj)


def _count(obj: bpy.types.Object) -> int:
    """Number of vertices of a visible mesh with its modifiers."""
    return len(mesh_of(obj.evaluated_get(evaluated_depsgraph(bpy.context))).vertices)


def _distances(obj: bpy.types.Object, positions: Mapping[int, FloatArray]) -> FloatArray:
    """Distances, (P, V), of positions from the vertices of a mesh."""
    places = _in_scene(obj)
    if not positions or not len(places):
        return np.full((len(positions), 1), np.inf)
    return np.array([np.linalg.norm(places - position, axis=1) for position in positions.values()])


@dataclass(frozen=True)
class BoundCharacter:
    """A character that was bound, in the open file.

    Attributes
    ----------
    head : bpy.types.Object
        The mesh with the skin of its face.
    binding : Binding or None
        None if it is bound by its shape keys alone.
    problems : list of str
        What keeps it from being driven well.
    keys : MadeKeys or None
        The shape keys that were made.
    controls : RigMap or None
        The controls of its own rig that were learnt.
    """

    head: bpy.types.Object
    binding: Binding | None
    problems: list[str]
    keys: MadeKeys | None = None
    controls: RigMap | None = None

    def doubt(self) -> str:
        """Return what to do if this may not be the face, and where the points that matter are now; "" if it is."""
        if self.binding is None or not self.binding.doubt:
            return ""
        places = _in_scene(self.head)
        digits = -floor(log10(_PRECISION * max(float(np.ptp(places, axis=0).max()), _PRECISION)))
        at = places[read_landmarks(self.head)[from_ibug(self.binding.wanted)]].round(digits) + 0.0
        now = " ".join(
            f"--mark {number}={','.join(map(str, place))}"
            for number, place in zip(self.binding.wanted, at.tolist(), strict=True)
        )
        return f"{self.binding.doubt}. They are at: {now}"

    def table(self) -> str:
        """Return a line for each part of each object, and for each bone."""
        rows = [("object", "part", "vertices")]
        rows += [(obj.name, PART_NAMES[part], str(count)) for obj, part, count in part_table(self.head)]
        widths = [max(len(row[i]) for row in rows) for i in range(2)]
        lines = [f"{name:{widths[0]}}  {part:{widths[1]}}  {count:>8}" for name, part, count in rows]
        armature, bones = read_bones(self.head)
        if armature is not None:
            chosen = {"head": bones.head, "right eye": bones.eye_right, "left eye": bones.eye_left}
            lines += [f"bone of the {name}: {bone}" for name, bone in chosen.items() if bone]
        how = "shape keys alone" if driven_by_keys(self.head) else "66 landmarks"
        return "\n".join([*lines, f"head: {self.head.name}, {how}"])

    def key_table(self) -> str:
        """Return a line for each shape key that was made: how far it moves, and what stays open or passes through."""
        qualities = [] if self.keys is None else self.keys.qualities
        rows = [["key", "moves %", "eyes %", "lips %", "crossing"]]
        rows += [
            [q.name, *(_percent(value) for value in (q.moved, q.eyes, q.lips)), str(q.crossing)] for q in qualities
        ]
        width = max(len(row[0]) for row in rows)
        return "\n".join(f"{row[0]:{width}}" + "".join(f"  {cell:>8}" for cell in row[1:]) for row in rows)

    def control_table(self) -> str:
        """Return a line for each control that was learnt: the region that it moves, and what its name says it is."""
        found = {} if self.controls is None else self.controls.regions
        rows = [("control", "region", "named"), *((name, region, role_of(name)) for name, region in found.items())]
        widths = [max(len(row[i]) for row in rows) for i in range(2)]
        return "\n".join(f"{name:{widths[0]}}  {region:{widths[1]}}  {role}".rstrip() for name, region, role in rows)


def _percent(share: float) -> str:
    return "" if np.isnan(share) else f"{100 * share:.1f}"


def bind(
    character: HeadFile,
    *,
    keys: KeySet | None,
    takes: Sequence[Take] = (),
    cut_open: bool = False,
    marks: Mapping[int, Mark] = _NO_MARKS,
    controls: bool = False,
) -> BoundCharacter:
    """Open or import a character and bind it, and make a set of shape keys if one is given.

    Joined lips and eyes are cut open first if `cut_open` is set. The takes refine the keys; marks are points of the
    face, by iBUG number. The controls of its own rig are learnt if `controls` is set. Raises FacemimeError if the file
    cannot be read, has no such object, no face is found, or no control moves it.
    """
    with read_from(character.path):
        open_file(character.path)
        chosen = object_named(character.path, character.name) if character.name else likely_mesh(character.path)
        with showing_scene(scene_of(chosen)):
            if character.name:
                choose_level(chosen)
            head, binding = _bound(chosen, marks)
            tell_of_lost_images(head)
            if binding is None:
                if controls:
                    raise HeadError(
                        "No face was found on {name}, which learning its controls requires. Mark points of its face.",
                        name=head.name,
                    )
                return BoundCharacter(head, None, [])
            prepare_imported(character.path, head)
            for step in [finding.step for finding in check_object(head)] if cut_open else []:
                if (cut := CUTS.get(step)) is not None:
                    cut(head)
            made = None if keys is None else make_expression_keys(head, keys, takes)
            if made is not None:
                tell(". ".join([made.summary(), *made.findings]))
            learnt = learn(head) if controls else None
            findings = [*binding.findings, *check_object(head)]
            problems = [f"{finding.problem} {finding.remedy}" for finding in findings]
            return BoundCharacter(head, binding, problems, made, learnt)


def _bound(chosen: bpy.types.Object, marks: Mapping[int, Mark]) -> tuple[bpy.types.Object, Binding | None]:
    """Bind a character by its face, or by its shape keys alone if no face is found; there is no binding then."""
    if marks:
        return bound_character(mark_points(chosen, marks))
    try:
        return bound_character(chosen)
    except HeadError:
        sets = [found for member in family_of(chosen) if (found := known_set(member)) is not None]
        if not any(found.sources >= ESSENTIAL for found in sets):
            raise
    head = bound_by_keys(chosen)
    tell(f"No face was found. {driven_by_its_keys(head)}")
    return head, None


def save(bound: BoundCharacter, output: Path) -> None:
    """Save the file with the character, whose head is active."""
    with showing_scene(scene_of(bound.head)):
        layer = bpy.context.view_layer
        for obj in layer.objects:
            obj.select_set(obj == bound.head)
        if bound.head.name in layer.objects:  # it is not where its collection is excluded
            layer.objects.active = bound.head
    save_blend(output)


def write_picture(bound: BoundCharacter, path: Path) -> None:
    """Write a picture of the face with its landmarks, which one that is driven by its shape keys alone lacks."""
    scene = scene_of(bound.head)
    with showing_scene(scene):
        write_image(path, draw_landmarks(scene, bound.head, 2 * AVATAR_SIDE))


def sample(character: HeadFile, clip: str = "") -> Take:
    """Open or import an animated character, bind it unless it is bound, and sample its motion as a take.

    The motion is that of the named clip; by default of what plays in the file. Raises FacemimeError if the file cannot
    be read, no face is found, the face does not move, or there is no such clip.
    """
    with read_from(character.path):
        head = open_head(character)
        _choose_clip(character.path, head, clip)
        scene = scene_of(head)
        sampling = Sampling(scene, head, character.path.name)
        progress = Progress(f"Sampling {head.name}", len(sampling.frames))
        with showing_scene(scene):
            for done in sampling:
                STOPPING.check()
                progress.update(done)
        progress.finish()
        return sampling.take()


def _choose_clip(path: Path, head: bpy.types.Object, name: str) -> None:
    """Play the clip `name` of a character, or say which other clips there are."""
    armature = armature_of(head)
    objects = character_of(head).union(() if armature is None else (armature,))
    owners = owners_of(sorted(objects, key=lambda obj: obj.name))
    clips = clips_of(owners)
    if name:
        play(clips, name, owners)
        clips = {name: replace(clips[name], plays=True)}
        set_frames(clips)
    others = [other for other, clip in clips.items() if not clip.plays]
    if others:
        playing = " and ".join(other for other, clip in clips.items() if clip.plays) or "None"
        tell(
            f"{path.name} has further clips: {', '.join(others)}. {playing} is sampled. To choose another: --clip NAME"
        )
