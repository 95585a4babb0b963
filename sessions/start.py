"""A live session from the scene's settings: the one function behind the operator, and what keeps it up to date."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy

from ..blender.animation.live import Follow, LiveHeadObject
from ..blender.meshes import read_rig, rig_checks
from ..core.errors import HeadError
from ..core.live.worker import LiveHead, LiveOptions
from ..settings.preferences import preferences
from ..settings.properties import FacemimeSettings
from ..settings.values import drive_settings, face_of, open_source, pose_targets, read_calibration, write_calibration
from .live import LiveSession


def start_session(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> LiveSession:
    """Begin to move `objects` as the settings of `scene` say.

    Raises
    ------
    FacemimeError
        Where one of them cannot be driven, a target or the source is not there, or a calibration is damaged.
    """
    if not objects:
        raise HeadError("No head is selected. Add one with Add > Mesh > Facemime Head, or bind your own.")
    settings = scene.facemime
    if settings.posing.object is not None and len(objects) > 1:
        raise HeadError("One pose object cannot take the pose of several heads. Clear it, or select one head.")
    options = drive_settings(settings)
    heads = [
        (LiveHeadObject(obj, pose_targets(settings.posing, obj), _follow(settings)), LiveHead(read_rig(obj), options))
        for obj in objects
    ]
    name = scene.name

    def keep_calibration(neutral) -> None:
        if (now := bpy.data.scenes.get(name)) is not None:
            write_calibration(now.facemime, neutral)

    session = LiveSession(
        open_source(settings.source),
        heads,
        neutral=read_calibration(settings),
        options=live_options(settings),
        on_calibrated=keep_calibration,
    )
    session.keep = settings.keep_pose
    return session


def live_options(settings: FacemimeSettings) -> LiveOptions:
    """What the worker does beside driving."""
    chosen = preferences()
    return LiveOptions(
        smoothing=settings.smoothing,
        preview=chosen.preview_size if chosen.preview else 0,
        face=face_of(settings.source),
    )


def follow_settings(session: LiveSession, settings: FacemimeSettings) -> None:
    """Let a running session follow the settings as they are; costs some microseconds where nothing has changed."""
    worker, options = session.worker, drive_settings(settings)
    session.keep = settings.keep_pose
    if worker.options != (wanted := live_options(settings)):
        worker.options = wanted
    if any(head.options != options for head in worker.heads):
        session.update([LiveHead(head.rig, options) for head in worker.heads])
    for shown in session.objects:
        shown.follow = _follow(settings)


class RigWatch:
    """Lets a running session follow what is painted, bound or chosen: a slice of a look at its heads at each `step`."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._checks: dict[int, Iterator[bool]] = {}

    def look(self) -> None:
        """Begin to look at all heads: something may have changed."""
        living = (number for number, shown in enumerate(self._session.objects) if not shown.gone)
        heads = self._session.worker.heads
        self._checks = {number: rig_checks(self._session.objects[number].obj, heads[number].rig) for number in living}

    def step(self) -> None:
        """Look at a slice of a head, and read the whole head again if that has changed; costs nothing between looks.

        Raises
        ------
        FacemimeError
            If a head can no longer be driven.
        """
        if not self._checks:
            return
        number, checks = next(iter(self._checks.items()))
        shown = self._session.objects[number]
        same = None if shown.gone or shown.obj.mode == "EDIT" else next(checks, None)
        if not same:
            del self._checks[number]
        if same is False:
            heads = list(self._session.worker.heads)
            heads[number] = LiveHead(read_rig(shown.obj), heads[number].options)
            self._session.update(heads)


def _follow(settings: FacemimeSettings) -> Follow:
    return Follow(rotation=settings.rotation, translation=settings.translation)
