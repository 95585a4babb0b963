"""Drawing in a viewport: text, lines, and dots; coordinates are pixels from the lower left corner of the region."""

from __future__ import annotations

import re
from inspect import signature
from typing import Any

import blf
import numpy as np
from numpy.typing import NDArray

_CORNERS = 12
_ANGLES = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_FONT = 0
_LEADING = 1.4
"""Distance of lines of text, relative to their size."""
WHITE = (1.0, 1.0, 1.0, 0.9)
_PLATE = (0.0, 0.0, 0.0, 0.85)
_WIDE = "\u2e80-\u9fff\uf900-\ufaff\uff00-\uffef"
"""Characters of Chinese and Japanese, between which a line may end."""
_OPENING = "\uff08\u300a\u300c\u201c"
_CLOSING = "\uff0c\u3002\u3001\uff1a\uff1b\uff01\uff1f\uff09\u300b\u300d\u201d"
"""Chinese brackets, quotation marks, and punctuation at the end of sentences and clauses."""
_PIECE = re.compile(rf" ?[{_OPENING}]*(?:[{_WIDE}]|[^ {_WIDE}{_OPENING}{_CLOSING}]+)[{_CLOSING}]*| ?\S")
"""Text that stays on one line: a word, or a wide character, with adjacent punctuation."""


class Picture:
    """A picture that is uploaded to the graphics card when it changes."""

    def __init__(self) -> None:
        self._texture: Any = None
        self._number: object = None

    def clear(self) -> None:
        """Free the texture."""
        self._texture, self._number = None, None

    def draw(
        self, number: object, rgba: NDArray[np.float32], place: tuple[float, float], size: tuple[float, float]
    ) -> None:
        """Draw RGBA (H, W, 4) from the lowest row up, 0 to 1; another `number` says that it is another picture."""
        import gpu
        from gpu_extras.presets import draw_texture_2d

        if number != self._number or self._texture is None:
            height, width = rgba.shape[:2]
            types: Any = gpu.types  # the stubs lack constructors
            buffer = types.Buffer("FLOAT", rgba.size, np.ascontiguousarray(rgba).reshape(-1))
            self._texture = types.GPUTexture((width, height), format="RGBA8", data=buffer)
            self._number = number
        gpu.state.blend_set("NONE")
        # Since Blender 5.0 the viewport's frame buffer leaves the conversion from linear light to the caller.
        conversion = signature(draw_texture_2d).parameters.keys() & {"is_scene_linear_with_rec709_srgb_target"}
        draw_texture_2d(self._texture, place, *size, **dict.fromkeys(conversion, True))


def dot(place: NDArray[np.float64], radius: float, colour: tuple[float, ...]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Triangulate a dot with its middle at `place` (2,): corners (3 T, 2) of T triangles, and their RGBA (3 T, 4)."""
    circle = place + radius * _CIRCLE
    fan = np.stack([np.broadcast_to(circle[:1], circle.shape), circle, np.roll(circle, -1, axis=0)], axis=1)
    rgba = np.array((*colour, 1.0)[:4], dtype=np.float32)
    return fan.reshape(-1, 2).astype(np.float32), np.tile(rgba, (3 * _CORNERS, 1))


def draw_triangles(triangles: list[tuple[NDArray[Any], NDArray[Any]]]) -> None:
    """Draw triangles, given as (corners, colours), in their order."""
    if triangles:
        _draw("TRIS", *(np.concatenate(part) for part in zip(*triangles, strict=True)))


def draw_rectangle(place: tuple[float, float], size: tuple[float, float], colour: tuple[float, ...]) -> None:
    """Draw a rectangle from its lower left corner."""
    low, high = np.array(place), np.array(place) + size
    corners = np.array([low, (high[0], low[1]), high, low, high, (low[0], high[1])], dtype=np.float32)
    draw_triangles([(corners, np.tile(np.array(colour, dtype=np.float32), (6, 1)))])


def draw_lines(ends: NDArray[np.float64], colour: tuple[float, float, float, float]) -> None:
    """Draw lines between N pairs of ends (N, 2, 2)."""
    places = ends.reshape(-1, 2).astype(np.float32)
    _draw("LINES", places, np.tile(np.array(colour, dtype=np.float32), (len(places), 1)))


def _draw(kind: str, places: NDArray[Any], colours: NDArray[Any]) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    gpu.state.blend_set("ALPHA")
    content: dict[str, Any] = {"pos": np.pad(places, ((0, 0), (0, 1))), "color": colours}
    batch_for_shader(shader, kind, content).draw(shader)
    gpu.state.blend_set("NONE")


def draw_text(
    text: str,
    place: tuple[float, float],
    size: float,
    colour: tuple[float, float, float, float] = WHITE,
    centred: bool = False,
) -> None:
    """Draw a line of text with a shadow; its baseline, and its left or, if `centred`, its middle are at `place`."""
    blf.size(_FONT, size)
    left = place[0] - (blf.dimensions(_FONT, text)[0] / 2 if centred else 0.0)
    blf.color(_FONT, *colour)
    blf.enable(_FONT, blf.SHADOW)
    blf.shadow(_FONT, 3, 0.0, 0.0, 0.0, 0.8)
    blf.position(_FONT, left, place[1], 0.0)
    blf.draw(_FONT, text)
    blf.disable(_FONT, blf.SHADOW)


def draw_plate(text: str, place: tuple[float, float], size: float) -> None:
    """Draw a line of text on a dark plate, readable on any background; parameters as for `draw_text`."""
    if not text:
        return
    blf.size(_FONT, size)
    width, pad = blf.dimensions(_FONT, text)[0], 0.4 * size
    draw_rectangle((place[0] - pad, place[1] - pad), (width + 2.0 * pad, 0.7 * size + 2.0 * pad), _PLATE)
    draw_text(text, place, size)


def draw_wrapped(text: str, place: tuple[float, float], size: float, width: float) -> None:
    """Draw text with a shadow, centred, in as many lines, up to `width` pixels wide, as it needs.

    The middle and the baseline of the first line are at `place`.
    """
    blf.size(_FONT, size)
    for number, line in enumerate(wrap(text, width)):
        draw_text(line, (place[0], place[1] - _LEADING * number * size), size, centred=True)


def wrap(text: str, width: float) -> list[str]:
    """Wrap `text` at spaces, and between characters of Chinese, to lines of a width in pixels.

    The font size is the one that was set with `blf`. A word that is wider has a line of its own.
    """
    lines: list[str] = []
    for piece in _PIECE.findall(" ".join(text.split())):
        if lines and blf.dimensions(0, lines[-1] + piece)[0] <= width:
            lines[-1] += piece
        else:
            lines.append(piece.lstrip())
    return lines
