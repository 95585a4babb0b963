"""Bared teeth: the lips' inner rims, where lips are red and what is between them is not, and whether teeth are shut
(method.md, section 3.13).

In grey, the lower teeth of a shut jaw look like a lip with a highlight, and the experts place the rims of lips that
bare them too close together. Colour tells the two apart. An open jaw leaves a dark gap between the teeth.
"""

from __future__ import annotations

from math import ceil, cos, nan
from statistics import median

import cv2
import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import LOWER_LIPS, UPPER_LIPS, from_ibug
from ..numeric.arrays import FloatArray
from .reference import warp_to_reference

_SCALE = 80.0
"""Pixels per outer-eye distance of the crop."""
_WIDTH = 13
"""Width of the crop in pixels: the middle of the mouth, whose rows are averaged."""
_HEIGHT = 96
"""Height of the crop in pixels: a mouth that is wide open."""
_MARGIN = 1.5
"""Distance in pixels from between the tracked rims within which teeth have to begin."""
_THINNEST = 1.6
"""Thickness in pixels that is left of a lip."""
_FAINT = 10.0
"""Difference in redness (a* of CIELAB) between lips and teeth from which teeth count. This and the next three were
chosen on one half of the strangers' clips (`lab.bench.strangers`)."""
_CLEAR = 18.0
"""Difference from which they count in full."""
_PALE = 0.3
"""Redness relative to that of the lips up to which teeth count in full."""
_PINK = 0.5
"""Relative redness from which nothing counts as teeth: gums and tongues are red, highlights on lips pink."""
_HALF_WAY = 0.5
"""Where the rim is between teeth and lip, as a share of the difference in redness."""
_RIM = 1.0
"""Distance in pixels from a rim within which rows belong neither to the lip nor to the opening."""
_FEWEST = 3
"""Smallest number of rows between lips that are not shut."""
_PARTED, _OPEN = 5.0, 8.0
"""Distances in pixels between the inner rims from which it counts whether teeth are shut, and from which it counts in
full: less is hardly seen, and a jaw is hardly open."""
_DARK, _LIGHT = 0.5, 0.8
"""Lightness of the darkest row between the lips, relative to that of the lips, up to which there is a dark gap between
the teeth, and from which there is none. These and the next two were chosen on one half of the strangers' clips."""
_TOOTH = 0.4, 0.55
"""Redness of what is between the lips, relative to theirs, up to which it is teeth, and from which it is a tongue, gums
or lips."""
_COLOURED = 4.0
"""Redness of lips, of 8 bits, below which an image has no colours."""
_TURNED = 0.7
"""Yaw in radians from which the middle of the mouth is not seen well enough."""
_STEEPEST = 0.5
"""Smallest cosine of the pitch by which heights in the image are divided."""
_RIMS = np.r_[from_ibug([51]), UPPER_LIPS, LOWER_LIPS, from_ibug([57])]
"""Landmarks in the middle of the mouth, downwards: outer rim, inner rims, outer rim."""


def bare_teeth(
    image: NDArray[np.uint8], pose: FloatArray, landmarks: FloatArray, shape: FloatArray
) -> tuple[FloatArray, float]:
    """Return `shape` with the inner rims of the lips as far apart as teeth are seen, and how surely these are shut.

    `image` is BGR (H, W, 3); `pose` (6,), `landmarks` (66, 2) in pixels and `shape` (66, 3), in the head frame and
    outer-eye distances, are as in `TrackResult`. The shape is `shape` itself if no rim moves. Teeth are as in
    `TrackResult.teeth`.
    """
    if abs(pose[2]) > _TURNED:
        return shape, nan
    rims, place = landmarks[_RIMS], pose.copy()
    place[4:6] = 0.5 * (rims[0] + rims[-1])
    crop = warp_to_reference(image, place, _SCALE, (_WIDTH, _HEIGHT))
    colours = cv2.cvtColor(cv2.reduce(crop.pixels, 1, cv2.REDUCE_AVG), cv2.COLOR_BGR2LAB)[:, 0]
    light, red = colours[:, 0].tolist(), colours[:, 1].tolist()
    rows = (rims @ crop.linear[1] + crop.shift[1]).tolist()
    top, upper, lower, bottom = rows[0], sum(rows[1:4]) / 3.0, sum(rows[4:7]) / 3.0, rows[7]
    up, down = _hidden(red, top, upper, lower, bottom)
    teeth = _shut(light, red, top, upper - up, lower + down, bottom)
    if up <= 0.0 and down <= 0.0:
        return shape, teeth
    out = shape.copy()
    upright = _SCALE * max(cos(pose[1]), _STEEPEST)
    out[UPPER_LIPS, 1] -= up / upright
    out[LOWER_LIPS, 1] += down / upright
    return out, teeth


def _shut(light: list[float], red: list[float], top: float, upper: float, lower: float, bottom: float) -> float:
    """How surely teeth fill the opening between the inner rims, at the rows `upper` and `lower`, 0 to 1.

    `top` and `bottom` are the rows of the outer rims, `light` and `red` the colours of all rows. NaN if lips have no
    colour.
    """
    between = slice(max(ceil(upper + _RIM), 0), max(int(lower - _RIM) + 1, 0))
    lips = [
        *range(max(int(top) + 1, 0), min(max(int(upper - _RIM), 0), _HEIGHT)),
        *range(max(ceil(lower + _RIM), 0), min(int(bottom) + 1, _HEIGHT)),
    ]
    if len(light[between]) < _FEWEST or not lips:
        return 0.0
    redness = median(red[row] for row in lips) - 128.0
    if redness < _COLOURED:
        return nan
    pink = (median(red[between]) - 128.0) / redness
    dark = min(light[between]) / max(median(light[row] for row in lips), 1.0)
    parted = _ramp(lower - upper, _PARTED, _OPEN)
    return parted * _ramp(dark, _DARK, _LIGHT) * (1.0 - _ramp(pink, *_TOOTH))


def _hidden(red: list[float], top: float, upper: float, lower: float, bottom: float) -> tuple[float, float]:
    """Pixels by which the inner rims, at the rows `upper` and `lower`, have to move up and down to bare the teeth.

    `top` and `bottom` are the rows of the outer rims.
    """
    first, last = max(int(np.ceil(top)), 0), min(int(bottom), _HEIGHT - 1)
    begin, end = max(int(np.ceil(upper - _MARGIN)), first + 1), min(int(lower + _MARGIN), last - 2)
    if begin > end:
        return 0.0, 0.0
    teeth = min(range(begin, end + 1), key=red.__getitem__)
    pale, above, below = red[teeth], max(red[first:begin]), max(red[end + 1 : last + 1])
    # Grey is 128 in 8 bits.
    lips = min(above, below)
    seen = _ramp(lips - pale, _FAINT, _CLEAR) * (1.0 - _ramp((pale - 128.0) / max(lips - 128.0, 1e-3), _PALE, _PINK))
    if seen <= 0.0:
        return 0.0, 0.0
    rise = _rim(red, teeth, -1, pale + _HALF_WAY * (above - pale), first)
    fall = _rim(red, teeth, 1, pale + _HALF_WAY * (below - pale), last)
    up = min(upper - rise, upper - top - _THINNEST)
    down = min(fall - lower, bottom - lower - _THINNEST)
    return seen * max(up, 0.0), seen * max(down, 0.0)


def _rim(red: list[float], row: int, step: int, level: float, end: int) -> float:
    """Where the redness reaches `level`, from `row` in steps of 1 or -1, but not beyond `end`."""
    while row != end and red[row + step] < level:
        row += step
    if row == end:
        return float(row)
    here, there = red[row], red[row + step]
    return row + step * min(max((level - here) / (there - here), 0.0), 1.0) if there > here else float(row)


def _ramp(value: float, low: float, high: float) -> float:
    """From 0 at `low` to 1 at `high`."""
    return min(max((value - low) / (high - low), 0.0), 1.0)
