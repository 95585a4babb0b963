"""Assignment of the pieces of a character's face to parts, by name and by place (method.md, section 7.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    JAW,
    MOUTH_CORNERS,
    MOUTH_INNER_LOWER,
    MOUTH_INNER_UPPER,
    outer_eye_distance,
)
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray
from .part_names import named_part, names_below_face, names_hair, names_inside, names_upper
from .rig import Part
from .tongues import fills_arch

_NEAR_EYE = 0.6
"""Largest distance of the middle of an eye's piece from the middle of the eye, seen from the front, in eye widths."""
_EYE_SIZE = (0.15, 1.5)
"""Range of the width of an eye's pieces, in widths of the opening between the lids."""
_BEYOND = 0.08
"""Outer-eye distances by which gums of both rows reach above and below where the rows meet; teeth overlap by less."""
_TALLEST = 0.7
"""Largest height of teeth and gums of both rows together, in outer-eye distances; that of ICT-FaceKit is 0.54."""
_TONGUE = 0.4
"""Largest height of a tongue in outer-eye distances. Those of nine heads are 0.09 to 0.32, gums and teeth of both rows
of ICT-FaceKit 0.54."""
_HIGHER = 0.03
"""Outer-eye distances by which the middle of a piece in the mouth is higher than that of another row."""
_MOUTH = (0.75, 0.45)
"""Half widths of the mouth, and outer-eye distances above and below it, within which pieces are teeth."""
_END = 0.1
"""Share of the height of the gums, at either end, that certainly belongs to that row. On ICT-FaceKit, whose motion is
known, every vertex that is visible from the front is assigned correctly with shares from 0.05 to 0.4."""
_FLAT = 0.2
"""Median distance from the rim of an eye's opening, in its widths, within which a piece as wide as the opening is no
eye but lashes, the edge of the lids or a film of tears. Eyeballs reach 0.5, their front halves 0.3."""
_WIDE = 0.75
"""Share of the opening's width above which a piece may be one of these, rather than an iris or a cornea; hair is no
lash or brow if it is narrower."""
_ALONG = 0.15
"""Distance, in outer-eye distances, from the rim of an eye or the middle of a brow within which lashes and brows lie:
on six characters 0.02 to 0.13. Pieces of a fringe are as near, but narrower."""
_CHIN = int(JAW[8])
_CLOSE = 0.12
"""Distance from the skin of the face, in outer-eye distances, within which a piece rides on it."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A connected piece of a mesh.

    Attributes
    ----------
    vertices : (N, 3) float
        Positions, in the head frame.
    names : tuple of str
        Names that describe it, the most specific first: those of its material and of its object, and of the neck's
        vertex group if it is in that.
    skin : bool
        Whether it is known to be skin because landmarks lie on it.
    away : float
        Distance from the skin within which 9 in 10 of its vertices lie, in outer-eye distances.
    moving : bool
        Whether the nearest skin moves, as the face does but skull and neck do not.
    joined : bool
        Whether some of its vertices coincide with vertices of the skin, as the wall of a mouth does at the lips.
    """

    vertices: FloatArray
    names: tuple[str, ...]
    skin: bool = False
    away: float = 0.0
    moving: bool = True
    joined: bool = False


def sort_pieces(pieces: Sequence[Piece], points: FloatArray) -> list[Part | None]:
    """Assign all pieces of the meshes around a face to parts; None for one with both rows of teeth (see `lower_row`).

    Names decide first, as they were given by the maker of the character. Without one the place relative to the
    landmarks `points` (66, 3) decides, in the head frame: an eye lies behind the lids, teeth lie behind the lips, and a
    piece close to moving skin rides on it. All else rides on the head, as do a neck, limbs and clothes by their names.
    """
    unit = outer_eye_distance(points)
    middle = np.asarray(points, dtype=np.float64)[MOUTH_CORNERS].mean(axis=0)
    parts: list[Part | None] = []
    for piece in pieces:
        named, inside = named_part(piece.names), names_inside(piece.names[0])
        if named == Part.ON_SKIN and not piece.joined and inside:
            named = None
        if piece.skin:
            parts.append(Part.SKIN)
        elif named is None and any(map(names_below_face, piece.names)):
            parts.append(Part.ON_HEAD)
        elif named in (Part.TEETH_UPPER, Part.TEETH_LOWER) or (named is None and _is_in_mouth(piece, points, unit)):
            parts.append(named if named == Part.TEETH_LOWER else Part.TEETH_UPPER)
        elif named == Part.EYE_LEFT or (named is None and _is_eye(piece, points)):
            parts.append(Part.EYE_LEFT if piece.vertices[:, 0].mean() > middle[0] else Part.EYE_RIGHT)
        elif named == Part.ON_HEAD and names_hair(piece.names) and _is_lash_or_brow(piece, points, unit):
            parts.append(Part.ON_SKIN)
        elif named is not None:
            parts.append(named)
        else:
            parts.append(Part.ON_SKIN if inside or (piece.away < _CLOSE and piece.moving) else Part.ON_HEAD)
    _divide_teeth(pieces, parts, points, unit)
    return parts


def lower_row(vertices: FloatArray, faces: IntArray, points: FloatArray) -> NDArray[np.bool_]:
    """Find the vertices that move with the lower teeth in a piece with both rows, such as gums joined to the tongue.

    To these, the lowest vertices are nearer along the surface than the highest. A tongue lies above the edge of the
    lower teeth, but grows from below. Vertices (N, 3) and landmarks `points` (66, 3) are in the head frame.
    """
    height = np.asarray(vertices)[:, 1]
    ends = _END * float(np.ptp(height))
    upper, lower = np.flatnonzero(height <= height.min() + ends), np.flatnonzero(height >= height.max() - ends)
    nearest = SurfaceGraph(vertices, faces).nearest_seeds(np.concatenate([upper, lower]))
    slit = float(np.asarray(points)[np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])].mean(axis=0)[1])
    return np.where(nearest < 0, height > slit, np.isin(nearest, lower))


def _divide_teeth(pieces: Sequence[Piece], parts: list[Part | None], points: FloatArray, unit: float) -> None:
    """Separate rows of teeth whose names do not, by the largest gap between the heights of their middles.

    A tongue without a name, which lies between them, moves with the lower ones.
    """
    upper = [i for i, part in enumerate(parts) if part == Part.TEETH_UPPER]
    if not upper:
        return
    middles = {i: float(y.min() + y.max()) / 2.0 for i, y in ((i, pieces[i].vertices[:, 1]) for i in upper)}
    highest = min(middles.values())
    unsure = [i for i in upper if not names_upper(pieces[i].names)]
    for i in list(unsure):
        below = middles[i] > highest + _HIGHER * unit and pieces[i].vertices[:, 1].min() > highest
        if below and fills_arch(pieces[i].vertices, unit):
            parts[i] = Part.TEETH_LOWER
            unsure.remove(i)
    if not unsure:
        return
    slit = float(np.asarray(points)[np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])].mean(axis=0)[1])
    if len(upper) == 1 and _is_lone_tongue(pieces[upper[0]].vertices, slit, unit):
        parts[upper[0]] = Part.TEETH_LOWER
        return
    heights = np.array([middles[i] for i in unsure])
    order = np.sort(heights)
    gaps = np.diff(order)
    border = slit
    if len(gaps) and gaps.max() > _HIGHER * unit:
        at = int(np.argmax(gaps))
        border = float(order[at] + order[at + 1]) / 2.0
    for i, height in zip(unsure, heights, strict=True):
        y = pieces[i].vertices[:, 1]
        both = min(border - y.min(), y.max() - border) > _BEYOND * unit
        if both or (len(unsure) == 1 and np.ptp(y) > 0.12 * unit):
            parts[i] = None
        elif height > border:
            parts[i] = Part.TEETH_LOWER


def _is_lone_tongue(vertices: FloatArray, slit: float, unit: float) -> bool:
    """Return whether the only piece (N, 3) in a mouth is a tongue, rather than both rows of teeth or a palate.

    `slit` is the height between the lips.
    """
    low, high = float(vertices[:, 1].min()), float(vertices[:, 1].max())
    at_floor = 0.5 * (low + high) > slit - _HIGHER * unit
    return at_floor and high - low < _TONGUE * unit and fills_arch(vertices, unit)


def _is_eye(piece: Piece, points: FloatArray) -> bool:
    """Return whether a piece covers the middle of an eye's opening and is about as large."""
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    for lids in (EYE_RIGHT, EYE_LEFT):
        rim = np.asarray(points)[lids]
        middle, width = rim.mean(axis=0), float(np.ptp(rim[:, 0]))
        size = float((high - low)[:2].max()) / width
        near = np.linalg.norm(((low + high) / 2.0 - middle)[:2]) < _NEAR_EYE * width
        covers = (low[:2] < middle[:2]).all() and (high[:2] > middle[:2]).all()
        behind = -0.4 * width < low[2] - middle[2] < 1.2 * width
        if near and covers and behind and _EYE_SIZE[0] < size < _EYE_SIZE[1] * 1.6:
            return size < _WIDE or float(np.median(_from_line(piece.vertices, _closed(rim)))) > _FLAT * width
    return False


def _is_lash_or_brow(piece: Piece, points: FloatArray, unit: float) -> bool:
    """Return whether a piece of hair lies along the rim of an eye or along a brow, rather than hangs in front of it."""
    if not piece.moving:
        return False
    places = np.asarray(points)
    lines = [_closed(places[lids]) for lids in (EYE_RIGHT, EYE_LEFT)] + [places[BROWS[:5]], places[BROWS[5:]]]
    return any(
        np.ptp(piece.vertices[:, 0]) > _WIDE * np.ptp(line[:, 0])
        and np.quantile(_from_line(piece.vertices, line), 0.95) < _ALONG * unit
        for line in lines
    )


def _closed(rim: FloatArray) -> FloatArray:
    return np.concatenate([rim, rim[:1]])


def _from_line(vertices: FloatArray, line: FloatArray) -> FloatArray:
    """Distances of vertices (N, 3) from the line through points (P, 3), (N,)."""
    starts, along = line[:-1], np.diff(line, axis=0)
    away = np.asarray(vertices)[:, None] - starts
    share = np.clip((away * along).sum(axis=2) / np.maximum(np.square(along).sum(axis=1), 1e-30), 0.0, 1.0)
    return np.asarray(np.linalg.norm(away - share[..., None] * along, axis=2).min(axis=1))


def _is_in_mouth(piece: Piece, points: FloatArray, unit: float) -> bool:
    """Return whether a piece lies behind the lips, above the chin, and is narrower than the face there."""
    lips = np.asarray(points)[np.concatenate([MOUTH_INNER_UPPER, MOUTH_INNER_LOWER])].mean(axis=0)
    width = float(np.ptp(np.asarray(points)[MOUTH_CORNERS][:, 0]))
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    middle = (low + high) / 2.0
    brow = float(np.asarray(points)[BROWS][:, 1].mean())
    return bool(
        abs(middle[0] - lips[0]) < _MOUTH[0] * width
        and abs(middle[1] - lips[1]) < _MOUTH[1] * unit
        and middle[2] > lips[2] + 0.03 * unit
        and low[1] > brow
        and high[1] < float(np.asarray(points)[_CHIN][1])
        and (high - low)[0] < 1.5 * width
        and (high - low)[1] < _TALLEST * unit
    )
