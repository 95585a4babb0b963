"""`facemime bind` inside Blender: open or import a character, bind it, and save it with a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ...blender.animation.clips import clips_of, owners_of, play
from ...blender.animation.sampling import Sampling
from ...blender.characters import part_table, read_bones
from ...blender.contexts import scene_of, showing_scene
from ...blender.heads.binding import check_object
from ...blender.heads.expression_keys import MadeKeys, make_expression_keys
from ...blender.heads.family import armature_of, character_of, family_of
from ...blender.heads.keyed import bind_keys, driven_by_its_keys, known_set
from ...blender.heads.landmark_pictures import draw_landmarks
from ...blender.heads.marks import Mark, mark_points, position_of
from ...blender.meshes import driven_by_keys, read_landmarks
from ...core.bake.key_map import ESSENTIAL
from ...core.binding.bind import Binding
from ...core.errors import HeadError
from ...core.face.landmarks import from_ibug
from ...core.heads.parts import PART_NAMES
from ...core.keys.key_sets import KeySet
from ...core.media.images import write_image
from ...core.puppet.job import HeadFile
from ...core.takes.take import Take
from ..terminal.console import Progress, tell
from ..terminal.stopping import STOPPING
from .files import CUTS, bound_character, likely_mesh, object_named, open_file, open_head, read_from, set_frames
from .headless import AVATAR_SIDE, save_blend

_NO_MARKS: Mapping[int, Mark] = {}


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
    """

    head: bpy.types.Object
    binding: Binding | None
    problems: list[str]
    keys: MadeKeys | None = None

    def doubt(self) -> str:
        """Return what to do if this may not be the face, and where the points that matter are now; "" if it is."""
        if self.binding is None or not self.binding.doubt:
            return ""
        landmarks = read_landmarks(self.head)
        places = {
            number: position_of(self.head, int(landmarks[from_ibug([number])[0]])) for number in self.binding.wanted
        }
        now = " ".join(f"--mark {number}={','.join(f'{value:.4g}' for value in at)}" for number, at in places.items())
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


def _percent(share: float) -> str:
    return "" if np.isnan(share) else f"{100 * share:.1f}"


def bind(
    character: HeadFile,
    *,
    keys: KeySet | None,
    takes: Sequence[Take] = (),
    cut_open: bool = False,
    marks: Mapping[int, Mark] = _NO_MARKS,
) -> BoundCharacter:
    """Open or import a character and bind it, and make a set of shape keys if one is given.

    Joined lips and eyes are cut open first if `cut_open`.

    Parameters
    ----------
    character : HeadFile
        File and object of the character.
    keys : KeySet or None
        Shape keys to add.
    takes : sequence of Take
        Takes that refine these keys.
    cut_open : bool
        Whether joined lips and eyes are cut open.
    marks : mapping of int to Mark
        Points of the face, by iBUG number.

    Raises
    ------
    FacemimeError
        If the file cannot be read, has no such object, or no face is found.
    """
    with read_from(character.path):
        open_file(character.path)
        chosen = object_named(character.path, character.name) if character.name else likely_mesh(character.path)
        with showing_scene(scene_of(chosen)):
            return _bound_with_keys(chosen, marks, keys, takes, cut_open=cut_open)


def _bound_with_keys(
    chosen: bpy.types.Object, marks: Mapping[int, Mark], keys: KeySet | None, takes: Sequence[Take], *, cut_open: bool
) -> BoundCharacter:
    head, binding = _bound(chosen, marks)
    if binding is None:
        return BoundCharacter(head, None, [])
    for step in [finding.step for finding in check_object(head)] if cut_open else []:
        if (cut := CUTS.get(step)) is not None:
            cut(head)
    made = None if keys is None else make_expression_keys(head, keys, takes)
    if made is not None:
        tell(". ".join([made.summary(), *made.findings]))
    findings = [*binding.findings, *check_object(head)]
    return BoundCharacter(head, binding, [f"{finding.problem} {finding.remedy}" for finding in findings], made)


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
    head = bind_keys(chosen)
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
    """Write a picture of the face with its landmarks."""
    scene = scene_of(bound.head)
    with showing_scene(scene):
        write_image(path, draw_landmarks(scene, bound.head, 2 * AVATAR_SIDE))


def sample(character: HeadFile, clip: str = "") -> Take:
    """Open or import an animated character, bind it unless it is bound, and sample its motion as a take.

    Parameters
    ----------
    character : HeadFile
        File and object of the character.
    clip : str
        Name of the clip that is sampled; by default what plays in the file.

    Raises
    ------
    FacemimeError
        If the file cannot be read, no face is found, the face does not move, or there is no such clip.
    """
    with read_from(character.path):
        head = open_head(character)
        _choose_clip(character.path, head, clip)
        return _sampled(character.path, head)


def _sampled(path: Path, head: bpy.types.Object) -> Take:
    scene = scene_of(head)
    sampling = Sampling(scene, head, path.name)
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
