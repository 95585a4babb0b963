"""Start of a live session from the scene's settings, and its updates while it is running."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy

from ..blender.animation.live import Follow, LiveHeadObject
from ..blender.rigs import read_rig, rig_checks
from ..core.errors import HeadError
from ..core.live.worker import LiveHead, LiveOptions
from ..settings.preferences import preferences
from ..settings.properties import FacemimeSettings
from ..settings.values import drive_settings, face_of, open_source, pose_targets, read_calibration, write_calibration
from .live import LiveSession


def start_session(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> LiveSession:
    """Start a live session with the settings of a scene.

    Parameters
    ----------
    scene : bpy.types.Scene
    objects : sequence of bpy.types.Object
        The heads to move.

    Raises
    ------
    FacemimeError
        If a head cannot be driven, a pose object or the source is missing, or the calibration is damaged.
    """
    if not objects:
        raise HeadError("No head is selected. Add one with Add > Mesh > Facemime Head, or bind your own.")
    settings = scene.facemime
    if settings.posing.object is not None and len(objects) > 1:
        raise HeadError(
            "One pose object cannot take the pose of several heads. Clear Pose Object, or select a single head."
        )
    options = drive_settings(settings)
    shown = [LiveHeadObject(obj, pose_targets(settings.posing, obj), _follow(settings)) for obj in objects]
    heads = [(head, LiveHead(read_rig(head.obj), options, head.prepare)) for head in shown]
    name = scene.name

    def keep_calibration(neutral) -> None:
        if (current := bpy.data.scenes.get(name)) is not None:
            write_calibration(current.facemime, neutral)

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
    """Return the options of the worker: smoothing, preview, and the face to track."""
    user = preferences()
    return LiveOptions(
        smoothing=settings.smoothing,
        preview=user.preview_size if user.preview else 0,
        face=face_of(settings.source),
    )


def follow_settings(session: LiveSession, settings: FacemimeSettings) -> None:
    """Apply the current settings to a running session; takes a few microseconds if nothing has changed.

    Parameters
    ----------
    session : LiveSession
    settings : FacemimeSettings
    """
    worker, options = session.worker, drive_settings(settings)
    session.keep = settings.keep_pose
    if worker.options != (wanted := live_options(settings)):
        worker.options = wanted
    if any(head.options != options for head in worker.heads):
        session.update([replace(head, options=options) for head in worker.heads])
    for shown in session.objects:
        shown.follow = _follow(settings)


class RigWatch:
    """Updates a running session when its heads are painted or bound; each `step` checks a slice of a head."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._checks: dict[int, Iterator[bool]] = {}

    def look(self) -> None:
        """Start checking all heads."""
        living = (number for number, shown in enumerate(self._session.objects) if not shown.gone)
        heads = self._session.worker.heads
        self._checks = {number: rig_checks(self._session.objects[number].obj, heads[number].rig) for number in living}

    def step(self) -> None:
        """Check a slice of a head, and read the whole head again if it has changed; free if there is nothing to check.

        Raises
        ------
        FacemimeError
            If a head can no longer be driven.
        """
        if not self._checks:
            return
        number, checks = next(iter(self._checks.items()))
        shown = self._session.objects[number]
        unchanged = None if shown.gone or shown.obj.mode == "EDIT" else next(checks, None)
        if not unchanged:
            del self._checks[number]
        if unchanged is False:
            heads = list(self._session.worker.heads)
            heads[number] = replace(heads[number], rig=read_rig(shown.obj))
            self._session.update(heads)


def _follow(settings: FacemimeSettings) -> Follow:
    return Follow(rotation=settings.rotation, translation=settings.translation)
