"""A sheet of what each control of a rig does to the face, for riggers: a single HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np

from ..files.pages import html_page, inline_jpeg, jpeg_of
from ..heads.rig import HeadRig
from ..heads.thumbnail import draw_head, to_pixels
from ..numeric.arrays import FloatArray, IntArray
from .control_names import role_of
from .rig_map import LOCATION, PROPERTY, REGIONS, ROTATION, RigChannel, RigMap

SIDE = 176
"""Width and height of a picture in pixels."""
_ARROWS = 0.3
"""Motion of a vertex, relative to the largest, from which it has an arrow."""
_COLOUR = (60, 60, 230)
"""Colour of arrows, BGR."""
_STEPS = 2.0
"""Value that is shown, in the steps that were measured, within the range."""
_AXES = "XYZ"


@dataclass(frozen=True)
class Direction:
    """A direction of a channel on the sheet.

    Attributes
    ----------
    channel : RigChannel
    value : float
        Change of the channel from rest that is shown.
    moved : float
        Largest motion of the face that was measured at this value, in eye distances, as if the rig were linear.
    linearity : str
        Whether both directions do the same.
    """

    channel: RigChannel
    value: float
    moved: float
    linearity: str

    @property
    def caption(self) -> str:
        """What the direction is, its range, and what it does."""
        return f"{_name(self.channel)} {_text(self.channel, self.value)}: {100 * self.moved:.0f} % of the eye distance"

    @property
    def range(self) -> str:
        """The range of the channel."""
        low, high = (_text(self.channel, end) for end in (self.channel.low, self.channel.high))
        if np.isinf(self.channel.low) and np.isinf(self.channel.high):
            return "free"
        return f"{low} to {high}"


def directions_of(rig_map: RigMap) -> list[Direction]:
    """Return the directions of all channels, sorted by the region that their control moves."""
    regions, order = rig_map.regions, list(REGIONS)
    found = []
    for k, number in enumerate(rig_map.channel.tolist()):
        channel, most = rig_map.channels[number], float(np.linalg.norm(rig_map.effects[k], axis=1).max())
        steps = min(_STEPS, float(rig_map.upper[k]))
        value = steps * float(rig_map.scale[k])
        found.append(Direction(channel, value, steps * most / rig_map.unit, _linearity(rig_map, k)))
    return sorted(found, key=lambda each: (order.index(regions[each.channel.control]), each.channel.control))


def _linearity(rig_map: RigMap, k: int) -> str:
    channel = rig_map.channels[rig_map.channel[k]]
    if channel.low == 0.0 or channel.high == 0.0:
        return "one way"
    return "linear" if rig_map.opposite[k] < 0 else "not linear: its directions differ"


def control_picture(rig: HeadRig, sample: IntArray, rest: FloatArray, posed: FloatArray) -> bytes:
    """Draw a head whose vertices (V, 3) were moved from `rest`, with arrows at sampled ones, as a JPEG file."""
    middle = rest[rig.landmarks].mean(axis=0)
    picture = cv2.cvtColor(draw_head(rig, posed, middle, SIDE), cv2.COLOR_GRAY2BGR)
    size = np.linalg.norm(posed[sample] - rest[sample], axis=1)
    chosen = sample[size > max(_ARROWS * float(size.max(initial=0.0)), 1e-9)]
    for ends in to_pixels(rig, np.stack([rest[chosen], posed[chosen]], axis=1), middle, SIDE):
        start, end = np.rint(ends).astype(int).tolist()
        cv2.arrowedLine(picture, start, end, _COLOUR, 1, cv2.LINE_AA, tipLength=0.35)
    return jpeg_of(picture)


def sheet_page(title: str, rig_map: RigMap, directions: Sequence[Direction], pictures: Sequence[bytes]) -> str:
    """Return the page with a picture for each direction."""
    regions, parts, last = rig_map.regions, list[str](), ""
    articles: dict[str, list[str]] = {}
    for direction, picture in zip(directions, pictures, strict=True):
        articles.setdefault(direction.channel.control, []).append(_figure(direction, picture))
    for control, figures in articles.items():
        if regions[control] != last:
            last = regions[control]
            parts.append(f"<h2>{escape(last)}</h2>")
        role = f" <small>{escape(role_of(control))}</small>" if role_of(control) else ""
        parts.append(f"<article><h3>{escape(control)}{role}</h3>{''.join(figures)}</article>")
    return html_page(title, f"{title}: {len(rig_map.controls)} controls", parts)


def _figure(direction: Direction, picture: bytes) -> str:
    caption = f"{escape(direction.caption)}<br>Range: {escape(direction.range)}<br>{escape(direction.linearity)}"
    return f'<figure><img alt="" src="{inline_jpeg(picture)}"><figcaption>{caption}</figcaption></figure>'


def _name(channel: RigChannel) -> str:
    if channel.kind == PROPERTY:
        return channel.name
    return f"{'Location' if channel.kind == LOCATION else 'Rotation'} {_AXES[channel.index]}"


def _text(channel: RigChannel, value: float) -> str:
    """Return a value in Blender's unit: degrees for rotations."""
    if np.isinf(value):
        return "free"
    return f"{np.degrees(value):+.0f}°" if channel.kind == ROTATION else f"{value:+.3g}"
