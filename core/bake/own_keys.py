"""By what coefficients are multiplied for the keys that a head came with, so that these turn and shut its eyes as the
performer does (method.md, section 9.4).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..face.names import COEFFICIENT_INDEX, COEFFICIENTS
from ..face.rotation import fit_rotation
from ..heads.built_in import LOOK_ANGLES, LOOKS
from ..heads.key_map import KeyMap
from ..heads.rig import HeadRig, Part
from ..mesh.surface import border_twins, islands, triangulate
from ..mesh.triangles import rasterise
from ..numeric.arrays import FloatArray, IntArray

BLINKS = [COEFFICIENT_INDEX["eyeBlinkLeft"], COEFFICIENT_INDEX["eyeBlinkRight"]]
"""Coefficients that shut the left and the right eye."""
_LEAST_MOTION = 0.005
"""Motion by a key, in eye distances, from which a vertex counts as moved: the front of an eye turns by 1.4 degrees."""
_LEAST_VERTICES = 8
"""Smallest number of vertices of an eyeball."""
_LARGEST_MISFIT = 0.2
"""Largest share of a key's motion of an eyeball that is no rotation; on an avatar with keys of 23 degrees it is 0.1."""
_MOST = 3.0
"""Largest factor between the angle of a key and a phone's: beyond it, the key's range would end too soon."""
_STILL = 1e-3
"""Share of a blink's largest motion below which a vertex rests."""
_LID = 0.3
"""Share of a blink's largest motion above which a vertex belongs to a lid."""
_MARGIN = 0.1
"""What is seen around the lids, as a share of a blink's largest motion."""
_PIXELS = 30
"""Pixels of the picture of an eye for the largest motion of a lid."""
_LARGEST = 400
"""Largest width of the picture of an eye in pixels."""
_LEAST_OPENING = 0.3
"""Area of the eye that is seen at rest, in squares of the largest motion of a lid, below which no eye is recognised; on
the built-in heads and an avatar of Ready Player Me it is 1.8 to 3.3."""
_SLIVER = 0.02
"""Share of an eye that stays visible at a blink of 1, beyond what no blink covers, from which the eye counts as open:
0.07 on that avatar, 0.01 on the built-in heads."""
_SHUT = 0.01
"""The same, below which the eye counts as shut."""
_OPPOSITES = {("up", "down"), ("left", "right"), ("in", "out"), ("forward", "back"), ("open", "close")}
"""Words that, one after the other in either order, name a key that moves both ways: *Brow Up-Down*."""
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
"""A word of the name of a key, in camel case or between separators."""
_AMOUNTS = np.linspace(1.0, 1.4, 9)
"""Values of a blink that are tried."""


def look_factors(rig: HeadRig, table: KeyMap, offsets: Mapping[str, NDArray[np.float32]]) -> FloatArray:
    """Return by what to multiply the coefficients of `LOOKS`, (8,), so that keys turn eyes as far as the performer's.

    `offsets` are displacements of `rig.all_vertices`. A factor is 1 where keys turn no eyeball, and where the user has
    chosen a gain.
    """
    factors, apart = np.ones(len(LOOKS)), rig.kinds != Part.SKIN
    for place, (column, (_, axis, angle)) in enumerate(zip(LOOKS.tolist(), LOOK_ANGLES, strict=True)):
        rows = [row for row in table.rows if row.source == COEFFICIENTS[column] and row.key in offsets]
        if not rows or any(abs(row.gain) != 1.0 for row in rows):
            continue
        motion = np.sum([row.gain * offsets[row.key] for row in rows], axis=0)
        turning = np.flatnonzero(apart & (np.linalg.norm(motion, axis=1) > _LEAST_MOTION * rig.eye_distance))
        if len(turning) < _LEAST_VERTICES:
            continue
        rest = rig.all_vertices[turning].astype(np.float64)
        moved = rest + motion[turning]
        rest, moved = rest - rest.mean(axis=0), moved - moved.mean(axis=0)
        rotation = fit_rotation(rest, moved)
        if np.linalg.norm(moved - rest @ rotation.T) > _LARGEST_MISFIT * np.linalg.norm(moved - rest):
            continue  # lashes, or both eyes by one key
        forward = -rotation[:, 2]
        turned = float(np.arctan2(forward[axis], -forward[2]))
        if turned * angle > 0.0:
            factors[place] = np.clip(angle / turned, 1.0 / _MOST, _MOST)
    return factors


def lid_factors(
    vertices: FloatArray, faces: IntArray, table: KeyMap, offsets: Mapping[str, NDArray[np.float32]]
) -> FloatArray:
    """Return by what to multiply the coefficients of the left and the right blink, (2,), so that keys shut the eyes.

    The artists of many avatars stop short of it. What is seen of the eyes in front of the face decides, at increasing
    values of the keys. The vertices (B, 3) and faces are those of the whole face at rest, and `offsets` displacements
    (A, 3) of its first vertices. Both factors are the larger one of the two. They are 1 where keys shut the eyes at 1,
    where no eye is found between the lids, where coordinates are not finite, and where the user has chosen a gain.
    """
    rest = np.asarray(vertices, dtype=np.float64)
    motions = [_blink(table, offsets, COEFFICIENTS[column]) for column in BLINKS]
    known = [motion for motion in motions if motion is not None and motion.any() and np.isfinite(motion).all()]
    found = [_factor(rest, faces, motion) for motion in known] if np.isfinite(rest).all() else []
    return np.full(len(BLINKS), max(found, default=1.0))


def _blink(table: KeyMap, offsets: Mapping[str, NDArray[np.float32]], source: str) -> FloatArray | None:
    """Return the motion (A, 3) of the keys of a blink; None without keys, or if the user has chosen a gain.

    A key for both eyes moves them by one half for each.
    """
    keys = {row.key for row in table.rows if row.source == source and row.key in offsets}
    blinks, names = {COEFFICIENTS[column] for column in BLINKS}, sorted(keys)
    gains = [sum(row.gain for row in table.rows if row.key == key and row.source in blinks) for key in names]
    if not names or any(gain != 1.0 for gain in gains):
        return None
    return np.asarray(np.sum([offsets[key] for key in names], axis=0, dtype=np.float64))


def _factor(rest: FloatArray, faces: IntArray, motion: FloatArray) -> float:
    """Return the smallest value at which a blink, (A, 3), hides as much of the eye as it ever does."""
    motion = np.pad(motion, ((0, len(rest) - len(motion)), (0, 0)))
    far = np.linalg.norm(motion, axis=1)
    reach = float(far.max())
    lid = far > _LID * reach
    swept = np.concatenate([rest[lid], rest[lid] + motion[lid]])
    low = swept[:, :2].min(axis=0) - _MARGIN * reach
    high = swept[:, :2].max(axis=0) + _MARGIN * reach
    width = float((high - low).max())
    pixel = max(reach / _PIXELS, width / _LARGEST)
    corners = rest[np.where(faces < 0, faces[:, :1], faces)][..., :2]
    near = faces[((corners.min(axis=1) < high + width) & (corners.max(axis=1) > low - width)).all(axis=1)]
    # An eye is a piece that rests and lies behind the lids, unlike glasses, hair and lashes.
    pieces = islands(len(rest), near, border_twins(rest, near))
    front = np.full(pieces.max() + 1, np.inf)
    np.minimum.at(front, pieces, rest[:, 2])
    moves = np.zeros(len(front), dtype=bool)
    moves[pieces[far > _STILL * reach]] = True
    triangles = triangulate(near)
    piece = pieces[triangles[:, 0]]
    skin, eye = triangles[moves[piece]], triangles[~moves[piece] & (front[piece] > swept[:, 2].min())]
    both = np.concatenate([skin, eye])
    size = int(np.ceil(width / pixel))

    def seen(amount: float) -> float:
        places = rest + amount * motion
        shown = rasterise((places[:, :2] - low) / pixel, places[:, 2], both, size)
        return float((shown.triangle >= len(skin)).sum()) * (pixel / reach) ** 2

    opening = seen(0.0)
    if opening < _LEAST_OPENING:
        return 1.0
    least = seen(float(_AMOUNTS[-1]))
    if (seen(1.0) - least) / opening < _SLIVER:
        return 1.0
    return next(float(amount) for amount in _AMOUNTS if (seen(float(amount)) - least) / opening < _SHUT)


def _both_ways(key: str) -> bool:
    """Whether the name of a key states a direction and the opposite one."""
    words = [word.lower() for word in _WORD.findall(key)]
    return any({pair, pair[::-1]} & _OPPOSITES for pair in pairwise(words))


def reaching(
    ranges: Mapping[str, tuple[float, float]], table: KeyMap, lids: FloatArray
) -> dict[str, tuple[float, float]]:
    """Return the ranges of keys, as far as the mapping needs them.

    Those of blinks that end at 1 or later reach as far as the `lids`, (2,), need. Importers begin all ranges at 0;
    those of keys whose names state two directions, and which the mapping moves both ways, begin at -1.
    """
    wide = dict(ranges)
    for key in {row.key for row in table.rows if row.gain < 0.0 and _both_ways(row.key)} & wide.keys():
        low, high = wide[key]
        wide[key] = (-1.0 if low == 0.0 and high >= 1.0 else low, high)
    for column, factor in zip(BLINKS, lids.tolist(), strict=True):
        for key in {row.key for row in table.rows if row.source == COEFFICIENTS[column]} & wide.keys():
            low, high = wide[key]
            wide[key] = (low, max(high, factor) if high >= 1.0 else high)
    return wide
