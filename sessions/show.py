"""Display of a take on heads at the current frame, without baking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..blender.animation.live import Follow, LiveHeadObject, require_one_left
from ..blender.animation.live_keys import names_of
from ..blender.animation.live_mesh import clear_all_live
from ..blender.animation.scene_range import fit_range, outside_range
from ..blender.animation.taught import own_values
from ..blender.animation.taught_poses import OwnPoses
from ..blender.contexts import find_scene, push_undo
from ..blender.controls.stored import controls_state
from ..blender.heads.face_display import FaceDisplay
from ..blender.messages import show_error
from ..blender.registering import watch
from ..blender.rigs import read_rig
from ..blender.styles import read_style, style_state
from ..blender.timeline import frames_of, seconds_of
from ..blender.viewports import redraw
from ..core.drive.driver import HeadDriver, HeadFrame
from ..core.errors import FacemimeError, HeadError, Message
from ..core.heads.rig import HeadRig
from ..core.puppet.outputs import KeyDriver, LiveKeys
from ..core.puppet.performer import Performance
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.takes.take import Take
from ..core.tracking.result import TrackResult
from ..settings.values import place_take, pose_targets, puppet_settings
from .session import Session
from .start import controls_of, keys_of

_INTERVAL = 0.05
"""Seconds between two looks at the settings."""


@dataclass(frozen=True)
class _Wanted:
    """The settings of a scene that a shown take follows."""

    puppet: PuppetSettings
    drive_by: str
    rows: tuple[tuple[str, str, float, float], ...]
    styles: tuple[object, ...]
    controls: tuple[object, ...]

    @classmethod
    def of(cls, scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> _Wanted:
        """Read the settings, and the state of the styles of heads and of the controls of their rigs."""
        rows = tuple((row.source, row.key, row.gain, row.offset) for row in scene.facemime_takes.bake.rows)
        styles = tuple(style_state(obj) for obj in objects)
        controls = tuple(map(controls_state, objects))
        return cls(puppet_settings(scene.facemime), scene.facemime.drive_by, rows, styles, controls)


class TakeShow(Session):
    """Displays a take on heads at the current frame until `close`, in time with a bake.

    The settings and the frame of the scene are followed. Raises FacemimeError if a head cannot be driven, or the take
    contains no face.

    Attributes
    ----------
    scene : int
        `session_uid` of the scene.
    path : str
        Path of the take in the list.
    warnings : list of str
        What keeps the take from being seen.
    performance : Performance
    drivers : list of HeadDriver or KeyDriver
        Driver of each head.
    frames : list of HeadFrame or None
        What each head shows.
    before : dict of int to Values
        Values of the shape keys of each head at the start, by its `session_uid`.
    posed : dict of int to OwnPoses
        The controls of each head at the start, by its `session_uid`.
    start : float
        Frame of the scene at which the take starts.
    """

    def __init__(self, scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], take: Take, path: str = "") -> None:
        if not objects:
            raise HeadError("No head is selected. Use Add > Mesh > Facemime Head, or find the face of your own.")
        settings = scene.facemime
        self.path = path
        self._recorded, self._wanted = take, _Wanted.of(scene, objects)
        self.performance = Performance.of(take, self._wanted.puppet)
        self.before = {obj.session_uid: own_values(obj) for obj in objects}
        self.posed = {obj.session_uid: OwnPoses.of(obj, pose_targets(settings.posing, obj).values()) for obj in objects}
        self.frames: list[HeadFrame | None] = [None] * len(objects)
        keys = [keys_of(scene, obj) for obj in objects]
        follow = Follow(settings.rotation, settings.translation)
        heads = [
            LiveHeadObject(obj, pose_targets(settings.posing, obj), follow, names_of(own), controls_of(scene, obj))
            for obj, own in zip(objects, keys, strict=True)
        ]
        self.drivers = [self._driver(read_rig(obj), own, None) for obj, own in zip(objects, keys, strict=True)]
        self.scene = scene.session_uid
        self._shown_at, self._stood_still = 0.0, False
        super().__init__()
        self.heads = heads
        self._display = FaceDisplay(objects, bones=settings.hide_bones and bpy.context.mode != "POSE")
        bake = scene.facemime_takes.bake
        self.start = place_take(scene)
        frames = frames_of(scene, take.times, self.start)
        fit_range(scene, frames, bake.start, asked=bake.fit_range)
        self.warnings = [*self.overruled(), *filter(None, [outside_range(scene, frames)])]
        self.resume()
        push_undo("Preview on Head")
        watch(follow_settings, _INTERVAL)

    def _driver(self, rig: HeadRig, keys: LiveKeys | None, before: HeadDriver | None) -> HeadDriver | KeyDriver:
        driver = self.performance.driver(rig, before)
        return driver if keys is None else KeyDriver(driver, self.performance.neutral, keys)

    def follow(self, scene: bpy.types.Scene) -> bool:
        """Apply the current settings of the scene; return whether they have changed since the last call.

        Raises FacemimeError if a head cannot be driven with these settings.
        """
        before, wanted = self._wanted, self._read(scene)
        if wanted == before:
            return False
        if (wanted.puppet.smoothing, wanted.puppet.neutral) != (before.puppet.smoothing, before.puppet.neutral):
            self.performance = Performance.of(self._recorded, wanted.puppet)
        else:
            self.performance = replace(self.performance, settings=wanted.puppet.drive)
        self._drive(scene, wanted, same_rigs=replace(wanted, styles=before.styles) == before)
        return True

    def renew(self, scene: bpy.types.Scene, take: Take) -> None:
        """Display an edited version of the take; raises FacemimeError as `follow`."""
        self._recorded, wanted = take, self._read(scene)
        self.performance = Performance.of(take, wanted.puppet)
        self._drive(scene, wanted, same_rigs=True)

    def _read(self, scene: bpy.types.Scene) -> _Wanted:
        return _Wanted.of(scene, [shown.obj for shown in self.heads if not shown.gone])

    def _drive(self, scene: bpy.types.Scene, wanted: _Wanted, *, same_rigs: bool) -> None:
        """Prepare the drivers, whose deformers are prepared again unless the rigs but for their styles are the same."""
        self._wanted = wanted
        for number, shown in enumerate(self.heads):
            if not shown.gone:
                keys, driver = keys_of(scene, shown.obj), head_driver(self.drivers[number])
                rig = replace(driver.rig, style=read_style(shown.obj)) if same_rigs else read_rig(shown.obj)
                self.drivers[number] = self._driver(rig, keys, driver)
                shown.follow = Follow(wanted.puppet.rotation, wanted.puppet.translation)
                shown.drive_by(names_of(keys), controls_of(scene, shown.obj, shown.controls))
        self.show(scene)

    def show(self, scene: bpy.types.Scene) -> None:
        """Display the frame of the take nearest to the current frame; raises HeadError as `LiveHeadObject.write`."""
        if scene.session_uid != self.scene:
            return
        result = self.result(scene)
        self._shown_at = scene.frame_current_final
        require_one_left(self.heads)
        for number, shown in enumerate(self.heads):
            if not shown.gone:
                self.frames[number] = frame = self.drivers[number].frame(result)
                shown.write(frame)

    def catches_up(self, scene: bpy.types.Scene) -> bool:
        """Display the current frame if Edit Mode, which was left, has prevented that; return whether it has."""
        if not any(shown.is_stale for shown in self.heads):
            return False
        self.show(scene)
        return True

    def show_in_render(self, scene: bpy.types.Scene) -> None:
        """Display a frame of an animation that is being rendered, in the thread of the renderer.

        What is displayed must not be drawn meanwhile, or Blender crashes, so the interface has to be locked.
        """
        if scene.render.use_lock_interface:
            self.show(scene)
        elif scene.session_uid == self.scene and scene.frame_current_final != self._shown_at:
            self._stood_still = True

    def warn_of_still_render(self) -> None:
        """Say that the frames of an animation were rendered without being displayed."""
        if self._stood_still:
            self._stood_still = False
            show_error(
                Message("The preview stands still in the render. Bake the take, or turn on Render > Lock Interface.")
            )

    def result(self, scene: bpy.types.Scene) -> TrackResult:
        """Return the result in the frame of the take nearest to the current frame."""
        take = self.performance.take
        away = np.where(take.found, np.abs(take.times - seconds_of(scene, self.start)), np.inf)
        return take.result(int(away.argmin()))

    def resume(self) -> None:
        """Display the take on the heads."""
        for shown in self.heads:
            shown.attach()
        if (scene := find_scene(self.scene)) is not None:
            self.show(scene)

    def _restore(self, *, blocks: bool) -> None:
        self._display.close()
        removed = [shown.detach(keep=False, blocks=blocks) for shown in self.heads]
        removed.append(clear_all_live(blocks=blocks, but=self.blocks))
        if any(removed):
            push_undo("Stop Showing Take")


def head_driver(driver: HeadDriver | KeyDriver) -> HeadDriver:
    """Return the driver of the pose of a head, and of its skin unless its keys move it."""
    return driver.head if isinstance(driver, KeyDriver) else driver


def _show(scene: bpy.types.Scene, *_: object) -> None:
    session = TakeShow.running()
    if session is None:
        return
    rendering = bpy.app.is_job_running("RENDER")
    try:
        if rendering:
            session.show_in_render(scene)
        else:
            session.show(scene)
    except HeadError:  # the heads were changed or deleted
        if rendering:
            session.close_later()
        else:
            session.close()


def follow_settings() -> float | None:
    """Let a shown take follow the settings and modes, as no frame changes when a slider is moved."""
    session = TakeShow.running()
    if session is None:
        return None
    scene = find_scene(session.scene)
    if scene is None:
        session.close()
        return None
    try:
        session.rest_copies()
        session.warn_of_applied()
        session.warn_of_still_render()
        if session.follow(scene) or session.catches_up(scene):
            redraw(bpy.context)
    except FacemimeError as error:
        session.close()
        show_error(str(error))
    return _INTERVAL


HANDLERS = {"frame_change_post": _show}
TIMERS = (follow_settings,)
