"""The frame of a take whose landmarks are edited, over a whole viewport: image, landmarks, and their certainty."""

from __future__ import annotations

import bpy
import numpy as np

from ..blender.messages import interface as _
from ..blender.viewports import FreeBox, free_box, viewport_drawn
from ..core.face.landmarks import EDGES
from ..core.takes.table_times import timecode
from ..core.tracking.overlay import picture_for_gpu
from ..sessions.landmark_edit import LandmarkEdit
from .drawing import Picture, dot, draw_lines, draw_plate, draw_rectangle, draw_triangles

_BACKDROP = (0.06, 0.06, 0.06, 1.0)
_LINE = (1.0, 1.0, 1.0, 0.35)
_RIM = (0.0, 0.0, 0.0, 0.8)
_PINNED = (1.0, 1.0, 1.0)
_SURE = np.array([0.25, 0.85, 0.4])
"""Colour of a landmark of which the tracker is certain, RGB."""
_DOUBTFUL = np.array([1.0, 0.3, 0.15])
"""Colour of a landmark of which it is not."""
_RADIUS = 4.5
"""Radius of a landmark, in unscaled pixels."""
_TEXT = 12.0
_picture = Picture()


def _draw() -> None:
    edit, context = LandmarkEdit.current, bpy.context
    if edit is None:
        _picture.clear()
        return
    seen = viewport_drawn(context)
    if seen is None or seen.area.as_pointer() != edit.area:
        return
    scale = context.preferences.system.ui_scale
    box = free_box(seen.area, seen.region)
    edit.look_at(box)
    draw_rectangle((0.0, 0.0), (seen.region.width, seen.region.height), _BACKDROP)
    if (image := edit.image) is not None:
        corners = edit.to_region(np.array([(-0.5, edit.size[1] - 0.5), (edit.size[0] - 0.5, -0.5)]))
        low, high = corners.tolist()
        _picture.draw(edit.number, picture_for_gpu(image), (low[0], low[1]), (high[0] - low[0], high[1] - low[1]))
    _draw_landmarks(edit, scale)
    _draw_words(edit, box, scale)


def _draw_landmarks(edit: LandmarkEdit, scale: float) -> None:
    if not edit.editor.found:
        return
    places = edit.to_region(edit.landmarks)
    draw_lines(places[np.array(EDGES)], _LINE)
    pins, certainty = edit.editor.pins(), edit.editor.certainty[:, None]
    colours = certainty * _SURE + (1.0 - certainty) * _DOUBTFUL
    dots = []
    for number, place in enumerate(places):
        radius = scale * _RADIUS * (1.4 if number in (edit.under, edit.held) else 1.0)
        if number in pins:
            dots += [dot(place, radius + 4.0 * scale, _RIM), dot(place, radius + 2.5 * scale, _PINNED)]
        dots += [dot(place, radius + scale, _RIM), dot(place, radius, tuple(colours[number]))]
    draw_triangles(dots)


def _draw_words(edit: LandmarkEdit, box: FreeBox, scale: float) -> None:
    editor, size = edit.editor, _TEXT * scale
    left, top = box.left + 2.0 * size, box.top - 2.5 * size
    time = timecode(editor.time)
    lines = [_("{time}   frame {frame} of {count}").format(time=time, frame=editor.frame + 1, count=len(editor.take))]
    if not editor.found:
        lines.append(_("No face in this frame"))
    elif pins := len(editor.pins()):
        lines.append(_("Pins in this frame: {count}").format(count=pins))
    if edit.image is None:
        lines.append(_("The video of this take was not found: only its landmarks are shown"))
    if edit.under is not None and editor.found:
        lines.append(_("Certainty {percent:.0f} %").format(percent=100.0 * editor.certainty[edit.under]))
    for number, line in enumerate(lines):
        draw_plate(line, (left, top - 2.0 * number * size), size)


def unregister() -> None:
    """Free the texture."""
    _picture.clear()


OVERLAYS = {_draw: "POST_PIXEL"}
