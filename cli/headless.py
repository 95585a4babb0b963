"""`facemime puppet` inside Blender: open a head, animate it, save the file, and render pictures."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from ..blender import head_properties
from ..blender.animation.bake_report import PuppetReport
from ..blender.animation.exporting import caches_beside, export_gltf, saved_by_blender
from ..blender.animation.puppet import check_heads, puppet_head
from ..blender.animation.scene_range import holding_take
from ..blender.contexts import scene_of, showing_scene
from ..blender.controls.checks import measure_speed
from ..blender.controls.probing import Learning
from ..blender.controls.stored import are_known, require_storable, rig_group, write_controls
from ..blender.heads.new_heads import add_head
from ..blender.heads.parts import ensure_bones
from ..blender.meshes import mesh_of, write_selection
from ..blender.preview_scene import FaceView, face_view, setup_preview
from ..blender.rendering import render_frames, set_rate, without_subdivision, write_video
from ..blender.rigs import read_rig
from ..blender.styles import add_style
from ..blender.timeline import frames_of
from ..core.bake.bake_settings import AUTOMATIC, CONTROLS, BakeSettings
from ..core.control_points.selection import GreedySelection, from_json
from ..core.drive.driver import select_distinct_frames
from ..core.errors import OutputError, SourceError
from ..core.files.capture import VideoSource, check_readable, write_image
from ..core.files.frames import Frame, at_constant_rate
from ..core.files.reading import read_text
from ..core.heads.key_map import load_map
from ..core.heads.key_presets import ESSENTIAL
from ..core.heads.style import Style, load_style
from ..core.puppet.job import PuppetJob
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.rigs.rig_map import RigMap
from ..core.takes.take import Take
from ..core.tracking.overlay import contact_sheet, draw_face, draw_frame, draw_label
from .character_files import open_head
from .console import Progress, announced, tell
from .stopping import STOPPING

Image = NDArray[np.uint8]

AVATAR_SIDE = 512
_SHEET_TILES = 9
_TILE_SIDE = 320
_END_OF_BLEND = b"\xb1\xea\x92\x8f"
"""Last bytes of a compressed .blend file, as of any file in Zstandard's seekable format."""


@dataclass(frozen=True)
class Stage:
    """The scene and the head of a job, and its settings, including the content of files."""

    scene: bpy.types.Scene
    head: bpy.types.Object
    settings: PuppetSettings


def open_stage(job: PuppetJob) -> Stage:
    """Open the head of `job`, by default the built-in one in a new file, with its control points and its style.

    The built-in head has its face units as shape keys if the bake uses existing keys. Raises FacemimeError if a file
    cannot be read, the object does not exist, none or several have landmarks, or the head cannot be driven or baked.
    """
    head_properties.ensure_registered()
    settings = _settings(job)
    points = None if job.points is None else _points(job.points)
    style = None if job.style is None else _style(job.style)
    by_keys = {"mapped": frozenset(), AUTOMATIC: ESSENTIAL}.get(settings.bake.keys)
    head = _built_in(settings.bake) if job.head is None else open_head(job.head, by_keys=by_keys)
    if points is not None:
        write_selection(mesh_of(head), points)
    if style is not None:
        add_style(head, style, len(read_rig(head).all_vertices))
    if settings.bake.keys == CONTROLS:
        ensure_learnt(head)
    check_heads([head], settings.bake)
    return Stage(scene_of(head), head, settings)


def _moment(start: float, end: float) -> str:
    first, last = f"{start:.2f}", f"{end:.2f}"
    return f"{first} s" if first == last else f"{first} to {last} s"


def puppet(job: PuppetJob, stage: Stage, take: Take, video: Path | None) -> PuppetReport:
    """Animate the head by `take` and write all outputs; `video` is None if there is only the take."""
    scene, head, own = stage.scene, stage.head, job.head is not None
    if not own:
        set_rate(scene, float(take.info.get("fps", 25.0)))
    STOPPING.check()
    with showing_scene(scene), announced(f"Baking {int(take.found.sum())} frames to {head.name} ..."):
        view = face_view(head)
        report = puppet_head(scene, head, take, stage.settings)
    STOPPING.check()
    neutral = report.neutral
    tell(
        f"Baked {len(report.motion.times)} frames: {report.summary()}; "
        f"neutral face at {_moment(neutral.start, neutral.end)}"
    )
    for warning in report.warnings:
        tell(warning)
    if own:  # a file of the user keeps its camera and render settings
        save_blend(job.output)
    with showing_scene(scene):
        _write_others(job, stage, take, video, report, view)
    return report


def _write_others(
    job: PuppetJob, stage: Stage, take: Take, video: Path | None, report: PuppetReport, view: FaceView
) -> None:
    """Write the outputs other than the .blend of a user's own head."""
    scene, head = stage.scene, stage.head
    frames = frames_of(scene, take.times, report.start)
    if job.gltf is not None:
        with STOPPING.holding(), holding_take(scene, frames):
            export_gltf([head], job.gltf)
    setup_preview(scene, head, (AVATAR_SIDE, AVATAR_SIDE), view)
    if job.head is None:
        _look_through_camera()
        save_blend(job.output)
    if job.preview is not None:
        _write_preview(scene, take, video, report.start, job.preview)
    if job.sheet is not None:
        sheet_frames = np.flatnonzero(take.found)[select_distinct_frames(report.motion, _SHEET_TILES)]
        _write_sheet(scene, take, video, sheet_frames, report.start, job.sheet)


def _settings(job: PuppetJob) -> PuppetSettings:
    """The settings of `job`, with the content of its table, and the cache beside its output."""
    table = None
    if job.map is not None:
        check_readable(job.map)
        table = load_map(job.map)
    path = job.output if job.settings.bake.writes_cache else None
    return replace(job.settings, bake=replace(job.settings.bake, table=table, path=path))


def _points(path: Path) -> GreedySelection:
    check_readable(path)
    try:
        return from_json(read_text(path))
    except (OSError, ValueError) as error:
        raise SourceError(
            "{path} cannot be read ({error}). Use a file that facemime select -o wrote.", path=path, error=error
        ) from error


def _style(path: Path) -> Style:
    check_readable(path)
    return load_style(path)


def _built_in(bake: BakeSettings) -> bpy.types.Object:
    with STOPPING.holding():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return add_head(bpy.context, units=bake.uses_existing_keys)


def _look_through_camera() -> None:
    """Set all 3D viewports of the file to the camera view, with textures."""
    for screen in bpy.data.screens:
        for space in (area.spaces.active for area in screen.areas if area.type == "VIEW_3D"):
            assert isinstance(space, bpy.types.SpaceView3D) and space.region_3d is not None
            space.shading.type = "SOLID"
            space.shading.color_type = "TEXTURE"
            space.region_3d.view_perspective = "CAMERA"


def save_blend(path: Path) -> None:
    """Save the open file; an existing one is replaced only by a complete one. Raises OutputError if that fails."""
    with saved_by_blender(path, _is_complete) as temporary, STOPPING.holding(), caches_beside(path):
        bpy.ops.wm.save_as_mainfile(filepath=temporary, copy=True, compress=True)


def _is_complete(path: Path) -> bool:
    """Whether a .blend file has its end."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(_END_OF_BLEND)))
        return file.read() == _END_OF_BLEND


def _write_preview(scene: bpy.types.Scene, take: Take, video: Path | None, start: float, path: Path) -> None:
    """Write a video of the performer with landmarks beside the avatar, at the nominal rate of the source.

    `start` is the frame of the animated head's scene at 0 s.
    """
    fps = float(take.info.get("fps", 25.0))
    frames = list(at_constant_rate(_stamps(take), fps))
    width, height = _image_size(take)
    left_width = min(2 * AVATAR_SIDE, 2 * round(AVATAR_SIDE * width / height / 2))
    progress = Progress("Rendering", len(frames))
    avatars = _avatars(scene, np.array([frame.time for frame in frames]) + take.times[0], start)
    indices = [frame.index for frame in frames]
    pictures = _pictures(take, video, indices)

    def composed() -> Iterator[Image]:
        for i, (index, picture, avatar) in enumerate(zip(indices, pictures, avatars, strict=True)):
            STOPPING.check()
            progress.update(i + 1)
            yield np.hstack([draw_frame(picture, _landmarks(take, index), left_width, AVATAR_SIDE), avatar])

    with STOPPING.holding(), without_subdivision(scene):
        write_video(composed(), fps, path)
    progress.finish(str(path))


def _write_sheet(
    scene: bpy.types.Scene, take: Take, video: Path | None, frames: NDArray[np.intp], start: float, path: Path
) -> None:
    """Write a contact sheet of performer and avatar in frames (N,) of `take`; `start` is the scene's frame at 0 s."""
    avatars = _avatars(scene, take.times[frames], start)
    pairs = []
    for frame, picture, avatar in zip(frames, _pictures(take, video, frames.tolist()), avatars, strict=True):
        face = draw_face(picture, _landmarks(take, frame), _TILE_SIDE)
        small = cv2.resize(avatar, (_TILE_SIDE, _TILE_SIDE), interpolation=cv2.INTER_AREA)
        pairs.append((draw_label(face, f"{take.times[frame]:.2f} s"), np.asarray(small, dtype=np.uint8)))
    write_image(path, contact_sheet(pairs))


def _avatars(scene: bpy.types.Scene, times: NDArray[np.float64], start: float) -> Iterator[Image]:
    """Render the scene at `times` in seconds after the frame `start`; OutputError if a picture cannot be stored."""
    pictures = render_frames(scene, frames_of(scene, times, start), (AVATAR_SIDE, AVATAR_SIDE))
    try:
        for _ in times:
            with STOPPING.holding():
                picture = next(pictures)
            yield picture
    except (RuntimeError, OSError) as error:
        raise OutputError(
            "Blender cannot render a picture ({reason}). Free some space in {folder}, or set TMPDIR to another folder.",
            reason=str(error).strip().removeprefix("Error: "),
            folder=tempfile.gettempdir(),
        ) from error


def _stamps(take: Take) -> Iterator[Frame]:
    nothing = np.empty((0, 0, 3), dtype=np.uint8)
    for index, time in enumerate(take.times):
        yield Frame(nothing, float(time - take.times[0]), index)


def _landmarks(take: Take, frame: int) -> NDArray[np.float64]:
    return np.asarray(take.landmarks[frame], dtype=np.float64)


def _image_size(take: Take) -> tuple[int, int]:
    width, height = take.info.get("image_size", (640, 480))
    return int(width), int(height)


def _pictures(take: Take, video: Path | None, indices: list[int]) -> Iterator[Image]:
    """Frames of the video by ascending `indices`; plain grey if there is only a take."""
    width, height = _image_size(take)
    if video is None:
        blank = np.full((height, width, 3), 40, dtype=np.uint8)
        for _ in indices:
            yield blank
        return
    with VideoSource(video) as source:
        wanted = iter(indices)
        index = next(wanted, None)
        for frame in source:
            while index == frame.index:
                yield frame.image
                index = next(wanted, None)
            if index is None:
                return


def learn(head: bpy.types.Object) -> RigMap:
    """Learn the controls of a head, and store them with it; raises HeadError if none moves its face."""
    head_properties.ensure_registered()
    require_storable(head)
    ensure_bones(head)
    with closing(Learning(head)) as learning:
        progress = Progress(f"Learning the controls of {head.name}", learning.total, unit="channels")
        for _ in learning.steps():
            STOPPING.check()
            progress.update(learning.done)
        progress.finish()
        found = learning.result()
    write_controls(head, found)
    measure_speed(head, found)
    tell(f"{len(found.controls)} controls found; they can show {round(100.0 * rig_group(head).shown)} %")
    return found


def ensure_learnt(head: bpy.types.Object) -> None:
    """Learn the controls of a head unless they are known, and the rig is as it was then."""
    if not are_known(head):
        learn(head)
