"""A live session from the scene's settings: the one function behind the operator, and what keeps it up to date."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..blender.live import Follow, LiveHeadObject
from ..blender.meshes import read_rig
from ..core.drive import HeadRig
from ..core.errors import HeadError
from ..core.live.worker import LiveHead, LiveOptions
from ..scene.preferences import preferences
from ..scene.properties import FacemimeSettings
from ..scene.settings import drive_options, face_of, open_source, pose_targets, read_calibration, write_calibration
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
    options = drive_options(settings)
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
    worker, options = session.worker, drive_options(settings)
    session.keep = settings.keep_pose
    if worker.options != (wanted := live_options(settings)):
        worker.options = wanted
    if any(head.options != options for head in worker.heads):
        session.update([LiveHead(head.rig, options) for head in worker.heads])
    for shown in session.objects:
        shown.follow = _follow(settings)


def follow_rigs(session: LiveSession) -> None:
    """Let a running session follow what was painted, bound or chosen since its heads were read.

    Raises
    ------
    FacemimeError
        Where a head can no longer be driven.
    """
    heads = session.worker.heads
    rigs = [head.rig if shown.gone else read_rig(shown.obj) for shown, head in zip(session.objects, heads, strict=True)]
    changed = [not _same(head.rig, rig) for head, rig in zip(heads, rigs, strict=True)]
    if any(changed):
        session.update(
            [LiveHead(rig, head.options) if new else head for head, rig, new in zip(heads, rigs, changed, strict=True)]
        )


def _follow(settings: FacemimeSettings) -> Follow:
    return Follow(rotation=settings.rotation, translation=settings.translation)


def _same(one: HeadRig, other: HeadRig) -> bool:
    names = (
        "vertices",
        "landmarks",
        "region_weights",
        "jaw_pivot",
        "eyeballs",
        "control_points",
        "covariance",
        "faces",
    )
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)
