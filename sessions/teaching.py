"""Teaching a head by frames of the take that it shows, and the frames for which that would help most."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender.animation.live import LiveHeadObject
from ..blender.animation.live_keys import names_of
from ..blender.animation.taught import edited_keys, edited_shape, reset_keys
from ..blender.controls.view import seen_vertices
from ..blender.messages import displayable
from ..blender.styles import read_style, write_example
from ..blender.timeline import frames_of
from ..core.drive.driver import HeadFrame
from ..core.drive.teaching import (
    TaughtKeys,
    doubts_of,
    require_expression,
    same_expression,
    suggest_frames,
    taught_keys,
)
from ..core.errors import HeadError, Message
from ..core.heads.style import Example
from ..core.heads.thumbnail import thumbnail
from ..core.numeric.arrays import FloatArray
from ..core.puppet.outputs import KeyDriver
from ..settings.performers import selected_performer
from .show import TakeShow, head_driver


def shown_head(show: TakeShow, obj: bpy.types.Object | None) -> int:
    """Return the number of `obj` among the heads that show a take, or that of the only one.

    Raises HeadError if it is not clear which is meant.
    """
    living = [number for number, shown in enumerate(show.heads) if not shown.gone]
    found = [number for number in living if show.heads[number].obj == obj] or living
    if len(found) != 1:
        raise HeadError("Several heads show the take. Make the one that you mean active.")
    return found[0]


def teach(show: TakeShow, scene: bpy.types.Scene, number: int) -> list[str]:
    """Teach a head, by its number, that in the current frame it should look as it does.

    The user's changes are then taken back, as the head shows them by itself. Returns the names of shape keys for which
    that is not possible, as drivers move them. Raises HeadError if the head looks as the take shows it, or is at rest.
    """
    bpy.context.view_layer.update()
    shown, frame = show.heads[number], show.frames[number]
    if frame is None:
        raise HeadError("The head does not show the take yet. Go to another frame and back.")
    example = _example(show, scene, number, frame)
    stored = read_style(shown.obj)
    write_example(shown.obj, example, same_expression(stored, example.expression))
    left = reset_keys(shown.obj, shown.keys, show.before.get(shown.obj.session_uid, {}))
    show.follow(scene)
    return left


def _example(show: TakeShow, scene: bpy.types.Scene, number: int, frame: HeadFrame) -> Example:
    shown, driver, result = show.heads[number], show.drivers[number], show.result(scene)
    posed = head_driver(driver)
    expression = posed.expression(result)
    require_expression(expression)
    performer = selected_performer(scene.facemime)
    example = Example(
        name=displayable(Message("Frame {frame}", frame=scene.frame_current)),
        performer=str(show.performance.take.info.get("source", "")) if performer is None else performer.name,
        expression=expression,
    )
    if isinstance(driver, KeyDriver):
        _require_unposed(show, shown.obj)
        changed, vertices = _keys(show, shown, driver, frame, expression)
        return replace(example, keys=changed, thumbnail=thumbnail(posed.rig, vertices))
    if shown.controls is not None:
        changes, vertices = _controls(show, shown, frame)
        return replace(example, controls=changes, thumbnail=thumbnail(posed.rig, vertices))
    wanted = edited_shape(shown.obj, frame, show.before.get(shown.obj.session_uid, {}))
    if (own := show.posed.get(shown.obj.session_uid)) is not None:
        wanted = own.added(wanted, posed.rig.eye_distance)
    if not posed.edited(frame, wanted).any():
        raise _unchanged(shown.obj)
    old, new = edited_keys(shown.obj, {}, show.before.get(shown.obj.session_uid, {}))
    before = TaughtKeys(posed.rig.style).changes(expression)
    every = {**dict.fromkeys(before, 0.0), **old}
    return replace(
        example,
        offsets=posed.offsets(frame, wanted),
        keys=taught_keys(every, every | new, before),  # for bakes by a mapping
        thumbnail=thumbnail(posed.rig, wanted),
    )


def _keys(
    show: TakeShow, shown: LiveHeadObject, driver: KeyDriver, frame: HeadFrame, expression: FloatArray
) -> tuple[dict[str, float], NDArray[np.float32]]:
    """Return the changes of keys to teach, and the vertices with them."""
    names = names_of(driver.keys)
    values = dict(zip(names, frame.keys.tolist(), strict=True))
    old, new = edited_keys(shown.obj, values, show.before.get(shown.obj.session_uid, {}))
    if not new:
        raise _unchanged(shown.obj)
    every = {**values, **old}
    vertices = np.array(frame.vertices)
    for name in new.keys() & driver.keys.offsets.keys():
        vertices += np.float32(new[name] - old[name]) * driver.keys.offsets[name]
    return taught_keys(every, every | new, driver.taught.changes(expression)), vertices


def _require_unposed(show: TakeShow, head: bpy.types.Object) -> None:
    """Raise HeadError if controls of a head that its keys drive were posed."""
    own = show.posed.get(head.session_uid)
    if own is not None and (names := own.changed()):
        raise HeadError(
            "{name} is driven by its shape keys, so that {names} cannot be taught. Change shape keys instead, or "
            "choose Controls or Skin as Driven By.",
            name=head.name,
            names=", ".join(names),
        )


def _controls(show: TakeShow, shown: LiveHeadObject, frame: HeadFrame) -> tuple[dict[str, float], NDArray[np.float32]]:
    """Return the changes of controls to teach, and the vertices with them."""
    used = () if shown.controls is None else shown.controls.channels
    own = show.posed.get(shown.obj.session_uid)
    if own is not None and (others := own.changed(but=used)):
        raise HeadError(
            "{names} do not show the take, and cannot be taught. Enable them in Head > Controls, or put them back.",
            names=", ".join(others),
        )
    if not (changes := shown.taught_controls()):
        raise _unchanged(shown.obj)
    vertices = seen_vertices(shown.obj)
    return changes, frame.vertices if vertices is None else vertices


def _unchanged(obj: bpy.types.Object) -> HeadError:
    return HeadError(
        "{name} looks as the take shows it. Change its shape keys, pose its controls, or sculpt it, and then teach the "
        "frame. Make Expression Keys adds shape keys to a head without any.",
        name=obj.name,
    )


def suggested_frames(show: TakeShow, scene: bpy.types.Scene, number: int, count: int) -> list[int]:
    """Return the frames of a scene in which teaching a head, by its number, would help most, in order of time."""
    take, driver = show.performance.take, head_driver(show.drivers[number])
    found = np.flatnonzero(take.found)
    expressions = np.array([driver.expression(take.result(int(frame))) for frame in found])
    taught = [example.expression for example in driver.rig.style.examples if not example.muted]
    rows = found[suggest_frames(expressions, doubts_of(take, found), taught, count)]
    return sorted({round(float(frame)) for frame in frames_of(scene, take.times[rows], show.start)})
