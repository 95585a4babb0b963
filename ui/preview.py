"""Preview of the source in the corner of the viewport, with the landmarks coloured by confidence, and the delay.

The worker has already drawn the landmarks into the image; this module only uploads it to the graphics card.
"""

from __future__ import annotations

from inspect import signature
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender.messages import interface as _
from ..blender.viewports import free_box, viewport_drawn
from ..operators.preview_place import MARGIN, Box, has_preview, preview_box
from ..operators.puppet import running
from ..sessions.live import LiveSession
from .drawing import draw_lines, draw_plate, draw_text, draw_wrapped
from .status import countdown_text, latency_text

_GRIP_COLOUR = (1.0, 1.0, 1.0, 0.8)
_RED = (1.0, 0.25, 0.2, 1.0)


class _Preview:
    """The texture of the newest image."""

    texture: Any = None
    number = -1


def _draw() -> None:
    session = running()
    if session is None:
        _Preview.texture = None
        return
    context, latest, seen = bpy.context, session.shown, viewport_drawn(bpy.context)
    if seen is None or context.screen is None:
        return
    scale = context.preferences.system.ui_scale
    if latest is not None and latest.preview is not None and has_preview(context.screen, seen.region):
        height, width = latest.preview.shape[:2]
        box = preview_box(seen.area, seen.region, (height, width))
        _draw_picture(latest.number, latest.preview, box)
        _draw_grip(box, scale)
        draw_plate(latency_text(session), (box.left, box.bottom + box.height + 6 * scale), 11 * scale)
    free = free_box(seen.area, seen.region)
    span = free.left, free.right
    _draw_countdown(span, seen.region.height, session, scale)
    if session.recorder.recording is not None:
        _draw_recording(span, free.top, session.recorder.recording.seconds, scale)


def _draw_picture(number: int, picture: NDArray[Any], box: Box) -> None:
    import gpu
    from gpu_extras.presets import draw_texture_2d

    if number != _Preview.number or _Preview.texture is None:
        height, width = picture.shape[:2]
        types: Any = gpu.types  # the stubs lack constructors
        buffer = types.Buffer("FLOAT", picture.size, np.ascontiguousarray(picture).reshape(-1))
        _Preview.texture = types.GPUTexture((width, height), format="RGBA8", data=buffer)
        _Preview.number = number
    gpu.state.blend_set("NONE")
    # Since Blender 5.0 the viewport's frame buffer leaves the conversion from linear light to the caller.
    conversion = signature(draw_texture_2d).parameters.keys() & {"is_scene_linear_with_rec709_srgb_target"}
    draw_texture_2d(_Preview.texture, box[:2], *box[2:], **dict.fromkeys(conversion, True))


def _draw_grip(box: Box, scale: float) -> None:
    """Draw two strokes in the corner that resizes the preview."""
    corner = np.array([box.left + box.width, box.bottom + box.height]) - 3.0 * scale
    ends = [[corner - (reach * scale, 0.0), corner - (0.0, reach * scale)] for reach in (6.0, 11.0)]
    draw_lines(np.array(ends), _GRIP_COLOUR)


def _draw_countdown(span: tuple[float, float], height: float, session: LiveSession, scale: float) -> None:
    if not (text := countdown_text(session)):
        return
    middle = sum(span) / 2, height / 2 - 36 * scale
    draw_text(text, middle, 96 * scale, centred=True)
    width = span[1] - span[0] - 2 * MARGIN * scale
    draw_wrapped(_(session.task), (middle[0], middle[1] - 40 * scale), 18 * scale, width)


def _draw_recording(span: tuple[float, float], height: float, seconds: float, scale: float) -> None:
    text = f"REC {int(seconds) // 60:02d}:{seconds % 60:04.1f}"
    draw_text(text, (sum(span) / 2, height - 40 * scale), 20 * scale, _RED, centred=True)


OVERLAYS = {_draw: "POST_PIXEL"}


def unregister() -> None:
    """Free the texture."""
    _Preview.texture = None
