"""What each control of a rig does to a face: a sheet for riggers, a single HTML file, and arrows on the face."""

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
from .rig_map import PROPERTY, REGIONS, ROTATION, RigChannel, RigMap

SIDE = 176
"""Width and height of a picture in pixels."""
_ARROWS = 0.3
"""Motion of a vertex, relative to the largest, from which it has an arrow on the sheet."""
_COLOUR = (60, 60, 230)
"""Colour of arrows, BGR."""
_STEPS = 2.0
"""Value that is shown, in the steps that were measured, within the range."""
_AXIS_NAMES = "XYZ"
_MOST = 40
"""Largest number of arrows of a single direction of a control."""
_SHARE = 0.25
"""Motion of a vertex, relative to the largest, below which it has no arrow on the face."""
_LENGTH = 0.2
"""Length of the longest arrow of a control, in eye distances."""
AXES = 4
"""Number of kinds of arrows: the three axes of a control, and properties."""


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
    return f"{channel.kind.capitalize()} {_AXIS_NAMES[channel.index]}"


def _text(channel: RigChannel, value: float) -> str:
    """Return a value in Blender's unit: degrees for rotations."""
    if np.isinf(value):
        return "free"
    return f"{np.degrees(value):+.0f}°" if channel.kind == ROTATION else f"{value:+.3g}"


@dataclass(frozen=True)
class Arrows:
    """Arrows that start at vertices (A,), and their vectors (A, 3) in the head frame, in the unit of the mesh.

    `axes` (A,) are the axes of the control, or 3 for a property.
    """

    vertices: IntArray
    vectors: FloatArray
    axes: IntArray


def control_arrows(rig_map: RigMap, control: str) -> Arrows:
    """Return how a control moves the face: an arrow at the vertices that each of its directions moves most."""
    own = [k for k in range(len(rig_map.channel)) if rig_map.channels[rig_map.channel[k]].control == control]
    parts = [_spread(rig_map, k) for k in own]
    if not parts:
        return Arrows(np.empty(0, dtype=np.intp), np.empty((0, 3)), np.empty(0, dtype=np.intp))
    vertices, vectors, axes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Arrows(vertices, vectors, axes)


def all_arrows(rig_map: RigMap) -> Arrows:
    """Return an arrow for each control, where and how it moves the face most."""
    sizes = np.linalg.norm(rig_map.effects, axis=2)
    most = sizes.max(axis=1, initial=0.0)
    best: dict[str, int] = {}
    for k in np.argsort(-most, kind="stable").tolist():
        best.setdefault(rig_map.channels[rig_map.channel[k]].control, k)
    chosen = np.array(list(best.values()), dtype=np.intp)
    places = sizes[chosen].argmax(axis=1) if len(chosen) else chosen
    vectors = rig_map.effects[chosen, places] * (_LENGTH * rig_map.unit / np.maximum(most[chosen], 1e-30))[:, None]
    return Arrows(
        rig_map.sample[places], vectors, np.array([_axis(rig_map, k) for k in chosen.tolist()], dtype=np.intp)
    )


def _spread(rig_map: RigMap, k: int) -> tuple[IntArray, FloatArray, IntArray]:
    """Arrows of a direction of a control, at vertices that are spread over what it moves."""
    size = np.linalg.norm(rig_map.effects[k], axis=1)
    most = float(size.max(initial=1e-30))
    # The landmarks come first in the sample, and outline the face best.
    moved = np.flatnonzero(size >= _SHARE * most)[:_MOST]
    vectors = rig_map.effects[k][moved] * (_LENGTH * rig_map.unit / most)
    return rig_map.sample[moved], vectors, np.full(len(moved), _axis(rig_map, k), dtype=np.intp)


def _axis(rig_map: RigMap, k: int) -> int:
    channel = rig_map.channels[rig_map.channel[k]]
    return AXES - 1 if channel.kind == PROPERTY else channel.index
