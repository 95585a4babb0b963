"""What the camera sees, in the viewport's corner: the picture, the landmarks coloured by confidence, and the delays.

The worker has drawn the landmarks into the picture; here it only goes to the graphics card. Nothing is done, and
nothing costs, where no session runs or the preview is off.
"""

from __future__ import annotations

from inspect import signature

import blf
import bpy
import bpy.utils.previews
import numpy as np

from ..operators.puppet import running
from ..sessions.live import LiveSession
from .status import latency_text

_MARGIN = 16
_TEXT = (1.0, 1.0, 1.0, 0.9)
_FONT = 0
_ICON = "face"


class _Corner:
    """Keeps the texture of the newest picture, the panel's icon, and the handler that draws."""

    handle: object = None
    texture: object = None
    number = -1
    icons: object = None


def _draw() -> None:
    session = running()
    if session is None:
        _Corner.texture = None
        return
    context, latest = bpy.context, session.shown
    if latest is None or context.region is None:
        return
    scale = context.preferences.system.ui_scale
    left = _left(context) + _MARGIN * scale
    if latest.preview is not None:
        height, width = latest.preview.shape[:2]
        _draw_picture(latest.number, latest.preview, (left, _MARGIN * scale), (width * scale, height * scale))
        _draw_text(latency_text(session), (left, height * scale + (_MARGIN + 6) * scale), 11 * scale)
    _draw_countdown(context.region, session, scale)


def panel_icon(session: LiveSession) -> int:
    """The newest picture as the value of an icon, for `template_icon`; 0 where there is none."""
    latest = session.shown
    if latest is None or latest.preview is None or _Corner.icons is None:
        return 0
    height, width = latest.preview.shape[:2]
    icon = _Corner.icons.get(_ICON) or _Corner.icons.new(_ICON)
    if tuple(icon.image_size) != (width, height):
        icon.image_size = (width, height)
    icon.image_pixels_float.foreach_set(np.sqrt(latest.preview).reshape(-1))
    return icon.icon_id


def _draw_picture(number: int, picture: np.ndarray, place: tuple[float, float], size: tuple[float, float]) -> None:
    import gpu
    from gpu_extras.presets import draw_texture_2d

    if number != _Corner.number or _Corner.texture is None:
        height, width = picture.shape[:2]
        buffer = gpu.types.Buffer("FLOAT", picture.size, np.ascontiguousarray(picture).reshape(-1))
        _Corner.texture = gpu.types.GPUTexture((width, height), format="RGBA8", data=buffer)
        _Corner.number = number
    gpu.state.blend_set("NONE")
    # From Blender 5 on the viewport's frame buffer leaves the change from linear light to whoever draws.
    changed = signature(draw_texture_2d).parameters.keys() & {"is_scene_linear_with_rec709_srgb_target"}
    draw_texture_2d(_Corner.texture, place, *size, **dict.fromkeys(changed, True))


def _draw_text(text: str, place: tuple[float, float], size: float) -> None:
    blf.size(_FONT, size)
    blf.color(_FONT, *_TEXT)
    blf.enable(_FONT, blf.SHADOW)
    blf.shadow(_FONT, 3, 0.0, 0.0, 0.0, 0.8)
    blf.position(_FONT, *place, 0.0)
    blf.draw(_FONT, text)
    blf.disable(_FONT, blf.SHADOW)


def _draw_countdown(region: bpy.types.Region, session: LiveSession, scale: float) -> None:
    left = session.countdown
    if left is None:
        return
    text = str(int(left) + 1) if left > 0 else bpy.app.translations.pgettext_iface("Hold")
    blf.size(_FONT, 96 * scale)
    width, height = blf.dimensions(_FONT, text)
    _draw_text(text, ((region.width - width) / 2, (region.height - height) / 2), 96 * scale)


def _left(context: bpy.types.Context) -> float:
    """Where the viewport begins that no toolbar covers."""
    tools = [region for region in context.area.regions if region.type == "TOOLS" and region.alignment == "LEFT"]
    overlaps = context.preferences.system.use_region_overlap
    return float(sum(region.width for region in tools if region.width > 1)) if overlaps else 0.0


def register() -> None:
    """Draw in every 3D viewport."""
    _Corner.icons = bpy.utils.previews.new()
    _Corner.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Stop drawing."""
    bpy.types.SpaceView3D.draw_handler_remove(_Corner.handle, "WINDOW")
    bpy.utils.previews.remove(_Corner.icons)
    _Corner.handle = _Corner.texture = _Corner.icons = None
