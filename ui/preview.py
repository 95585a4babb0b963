"""Preview of the source in the corner of the viewport, with the landmarks coloured by confidence, and the delay.

The worker has already drawn the landmarks into the image; this module only uploads it to the graphics card.
"""

from __future__ import annotations

from inspect import signature

import bpy
import bpy.utils.previews
import numpy as np

from ..operators.puppet import running
from ..sessions.live import LiveSession
from .drawing import draw_text
from .status import latency_text

MARGIN = 16
_RED = (1.0, 0.25, 0.2, 1.0)
_ICON = "face"


class _Preview:
    """The texture and icon of the newest image, and the draw handler."""

    handle: object = None
    texture: object = None
    number = -1
    icons: object = None


def _draw() -> None:
    session = running()
    if session is None:
        _Preview.texture = None
        return
    context, latest = bpy.context, session.shown
    if latest is None or context.region is None:
        return
    scale = context.preferences.system.ui_scale
    left = toolbar_width(context) + MARGIN * scale
    if latest.preview is not None:
        height, width = latest.preview.shape[:2]
        bottom = MARGIN * scale + redo_height(context)
        _draw_picture(latest.number, latest.preview, (left, bottom), (width * scale, height * scale))
        draw_text(latency_text(session), (left, bottom + (height + 6) * scale), 11 * scale)
    _draw_countdown(context.region, session, scale)
    if session.recording is not None:
        _draw_recording(context.region, session.recording.seconds, scale)


def panel_icon(session: LiveSession) -> int:
    """Return the newest image as an icon for `template_icon`; 0 if there is none."""
    latest = session.shown
    if latest is None or latest.preview is None or _Preview.icons is None:
        return 0
    height, width = latest.preview.shape[:2]
    icon = _Preview.icons.get(_ICON) or _Preview.icons.new(_ICON)
    if tuple(icon.image_size) != (width, height):
        icon.image_size = (width, height)
    icon.image_pixels_float.foreach_set(np.sqrt(latest.preview).reshape(-1))
    return icon.icon_id


def _draw_picture(number: int, picture: np.ndarray, place: tuple[float, float], size: tuple[float, float]) -> None:
    import gpu
    from gpu_extras.presets import draw_texture_2d

    if number != _Preview.number or _Preview.texture is None:
        height, width = picture.shape[:2]
        buffer = gpu.types.Buffer("FLOAT", picture.size, np.ascontiguousarray(picture).reshape(-1))
        _Preview.texture = gpu.types.GPUTexture((width, height), format="RGBA8", data=buffer)
        _Preview.number = number
    gpu.state.blend_set("NONE")
    # Since Blender 5.0 the viewport's frame buffer leaves the conversion from linear light to the caller.
    conversion = signature(draw_texture_2d).parameters.keys() & {"is_scene_linear_with_rec709_srgb_target"}
    draw_texture_2d(_Preview.texture, place, *size, **dict.fromkeys(conversion, True))


def _draw_countdown(region: bpy.types.Region, session: LiveSession, scale: float) -> None:
    left = session.countdown
    if left is None:
        return
    text = str(int(left) + 1) if left > 0 else bpy.app.translations.pgettext_iface("Hold Still")
    middle = region.width / 2, region.height / 2 - 36 * scale
    draw_text(text, middle, 96 * scale, centred=True)
    task = bpy.app.translations.pgettext_iface(session.task)
    draw_text(task, (middle[0], middle[1] - 40 * scale), 18 * scale, centred=True)


def _draw_recording(region: bpy.types.Region, seconds: float, scale: float) -> None:
    text = f"REC {int(seconds) // 60:02d}:{seconds % 60:04.1f}"
    draw_text(text, (region.width / 2, region.height - 70 * scale), 20 * scale, _RED, centred=True)


def toolbar_width(context: bpy.types.Context) -> float:
    """Return how much of the viewport the toolbar covers on the left, pixels."""
    tools = [region for region in context.area.regions if region.type == "TOOLS" and region.alignment == "LEFT"]
    overlaps = context.preferences.system.use_region_overlap
    return float(sum(region.width for region in tools if region.width > 1)) if overlaps else 0.0


def redo_height(context: bpy.types.Context) -> float:
    """Return how much of the viewport the panel of the last operator covers below, pixels."""
    return float(max((region.height for region in context.area.regions if region.type == "HUD"), default=0.0))


def register() -> None:
    """Add the draw handler to all 3D Viewports."""
    _Preview.icons = bpy.utils.previews.new()
    _Preview.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Remove the draw handler."""
    bpy.types.SpaceView3D.draw_handler_remove(_Preview.handle, "WINDOW")
    bpy.utils.previews.remove(_Preview.icons)
    _Preview.handle = _Preview.texture = _Preview.icons = None
