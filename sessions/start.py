"""Start of a live session from the scene's settings, and its updates while it is running."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import bpy

from ..blender.animation.live import Follow, LiveHeadObject
from ..blender.animation.live_controls import CONTROLS
from ..blender.animation.live_keys import KEYS, SKIN, live_keys, names_of
from ..blender.contexts import find_scene
from ..blender.controls.stored import controls_state, read_controls, used_controls
from ..blender.rigs import read_rig, rig_checks
from ..blender.styles import read_style, style_state
from ..core.errors import HeadError
from ..core.puppet.outputs import DrivenOutput, LiveHead, LiveKeys
from ..core.puppet.sources import LiveSource
from ..core.puppet.worker import LiveOptions
from ..core.rigs.rig_map import RigMap
from ..core.streams.source import StreamSource
from ..core.takes.neutral import Neutral
from ..core.tracking.tracker import TrackingSettings
from ..settings.performers import read_calibration, read_learnt, write_calibration
from ..settings.preferences import preferences
from ..settings.properties import FacemimeSettings
from ..settings.rna import read
from ..settings.takes_properties import read_table
from ..settings.values import (
    drive_settings,
    face_of,
    is_tracked,
    open_sender,
    open_source,
    people_of,
    pose_targets,
)
from .live import LiveSession, follow_viewer, open_vertices, open_viewer

_SELF = ("CAMERA", "STREAM")
"""Kinds of sources that show the performer whose calibration is selected; a video may show anyone."""


def start_session(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> LiveSession:
    """Start a live session that moves heads with the settings of a scene.

    Raises FacemimeError if a head cannot be driven, a pose object or the source is missing, or the calibration is
    damaged.
    """
    if not objects:
        raise HeadError("No head is selected. Use Add > Mesh > Facemime Head, or find the face of your own.")
    settings = scene.facemime
    if settings.posing.object is not None and len(objects) > 1:
        raise HeadError("One pose object cannot follow several heads. Clear Pose Object, or select a single head.")
    options = drive_settings(settings)
    keys = [keys_of(scene, obj) for obj in objects]
    shown = [
        LiveHeadObject(
            obj, pose_targets(settings.posing, obj), _follow(settings), names_of(own), controls_of(scene, obj)
        )
        for obj, own in zip(objects, keys, strict=True)
    ]
    heads = [
        (head, LiveHead(read_rig(head.obj), options, head.prepare, own)) for head, own in zip(shown, keys, strict=True)
    ]
    uid = scene.session_uid

    def keep_calibration(neutral: Neutral) -> None:
        current = find_scene(uid)
        if current is not None and tracked and not neutral.measured:
            write_calibration(current.facemime, neutral)

    tracked = is_tracked(settings.source)
    neutral = read_calibration(settings) if tracked else None
    learnt = read_learnt(settings) if tracked else ()
    live = settings.source.kind in _SELF
    if neutral is not None and not (neutral.asked or live):
        neutral = None
    source = open_source(settings.source)
    _choose_senders(source, objects)
    try:
        output = open_sender(settings)
    except Exception:
        source.close()
        raise
    session = LiveSession(
        source,
        heads,
        neutral=neutral,
        options=_live_options(settings, objects),
        on_calibrated=keep_calibration,
        on_learnt=keep_calibration if live else None,
        output=output,
    )
    session.worker.first.corrections = learnt
    session.keep, session.drive_by, session.styles = settings.keep_pose, settings.drive_by, _styles(shown)
    session.controls = _controls(shown)
    try:
        session.displays.view(open_viewer(settings, objects))
        session.displays.send_vertices(open_vertices(settings.output, objects))
    except Exception:
        session.close()
        raise
    return session


def keys_of(scene: bpy.types.Scene, obj: bpy.types.Object) -> LiveKeys | None:
    """Return the keys that drive a head, using the mapping in the panel if it has rows and is requested."""
    choice = SKIN if scene.facemime.drive_by == CONTROLS else scene.facemime.drive_by
    bake = scene.facemime_takes.bake
    return live_keys(obj, choice, read_table(bake) if choice == KEYS and len(bake.rows) else None)


def controls_of(scene: bpy.types.Scene, obj: bpy.types.Object, before: RigMap | None = None) -> RigMap | None:
    """Return the controls that drive a head; None if something else does. Raises FacemimeError as `read_controls`.

    `before` are those that drove it in a running session, in which there may be none for a while.
    """
    if scene.facemime.drive_by != CONTROLS:
        return None
    return read_controls(obj) if before is None else used_controls(obj)


def _styles(heads: Sequence[LiveHeadObject]) -> tuple[object, ...]:
    return tuple(() if shown.gone else style_state(shown.obj) for shown in heads)


def _controls(heads: Sequence[LiveHeadObject]) -> tuple[object, ...]:
    return tuple(() if shown.gone else controls_state(shown.obj) for shown in heads)


def _choose_senders(source: LiveSource, objects: Sequence[bpy.types.Object | None]) -> None:
    """Tell a source of several senders which of them drives which head."""
    if isinstance(source, StreamSource):
        source.chosen = tuple("" if obj is None else obj.facemime.sender.strip() for obj in objects)


def _live_options(settings: FacemimeSettings, objects: Sequence[bpy.types.Object | None]) -> LiveOptions:
    """Return the options of the worker: smoothing, preview, and the faces to track."""
    user = preferences()
    return LiveOptions(
        smoothing=settings.smoothing,
        preview=round(user.preview_size * bpy.context.preferences.system.ui_scale) if user.preview else 0,
        face=face_of(settings.source),
        tracking=read(TrackingSettings, settings),
        learn=settings.learn,
        people=people_of(settings.source, objects),
    )


def follow_settings(session: LiveSession, scene: bpy.types.Scene) -> None:
    """Apply the current settings of a scene to a running session; takes a few microseconds if nothing has changed.

    Raises HeadError if a head is to be driven by shape keys that it does not have.
    """
    settings = scene.facemime
    worker, options = session.worker, drive_settings(settings)
    state = settings.drive_by, _styles(session.heads), _controls(session.heads)
    if (session.drive_by, session.styles, session.controls) != state:
        session.drive_by, session.styles, session.controls = state
        heads = []
        for head, shown in zip(worker.heads, session.heads, strict=True):
            keys, rig = head.keys, head.rig
            if not shown.gone:
                keys, rig = keys_of(scene, shown.obj), replace(rig, style=read_style(shown.obj))
                shown.drive_by(names_of(keys), controls_of(scene, shown.obj, shown.controls))
            heads.append(replace(head, keys=keys, rig=rig))
        session.update(heads)
    session.keep = settings.keep_pose
    objects = [None if shown.gone else shown.obj for shown in session.heads]
    if worker.options != (wanted := _live_options(settings, objects)):
        worker.options = wanted
    if any(head.options != options for head in worker.heads):
        session.update([replace(head, options=options) for head in worker.heads])
    if isinstance(worker.output, DrivenOutput):
        worker.output.options = options
    _choose_senders(worker.source, objects)
    follow_viewer(session, settings)
    for shown in session.heads:
        shown.follow = _follow(settings)


class RigWatch:
    """Updates a running session when its heads are painted or bound; each `step` checks a slice of a head."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._checks: dict[int, Iterator[bool]] = {}

    def look(self) -> None:
        """Start checking all heads."""
        living = (number for number, shown in enumerate(self._session.heads) if not shown.gone)
        heads = self._session.worker.heads
        self._checks = {number: rig_checks(self._session.heads[number].obj, heads[number].rig) for number in living}

    def step(self) -> None:
        """Check a slice of a head, and read the whole head again if it has changed; free if there is nothing to check.

        Raises FacemimeError if a head can no longer be driven.
        """
        if not self._checks:
            return
        number, checks = next(iter(self._checks.items()))
        shown = self._session.heads[number]
        unchanged = None if shown.gone or shown.obj.mode == "EDIT" else next(checks, None)
        if not unchanged:
            del self._checks[number]
        if unchanged is False:
            heads = list(self._session.worker.heads)
            heads[number] = replace(heads[number], rig=read_rig(shown.obj))
            self._session.update(heads)


def _follow(settings: FacemimeSettings) -> Follow:
    return Follow(rotation=settings.rotation, translation=settings.translation)
