"""Creases of nose, forehead, eyes and mouth that actions draw into the skin, and that no render of a photo has."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from facemime.core.face.landmarks import from_ibug

from .drawing import line

_SHOWN, _FALSE = 0.7, 0.02
"""Share of actions that draw their creases, and of faces that have some without the action."""


def crease(
    image: np.ndarray, landmarks: np.ndarray, unit: float, actions: Mapping[str, float], rng: np.random.Generator
) -> np.ndarray:
    """Return a grey image with the creases of some actions; `unit` is pixels per outer-eye distance.

    The landmarks (66, 2) are in pixels. `actions` are activations of ICT-FaceKit's expressions, by name; those without
    creases are ignored.
    """
    relief = np.zeros(image.shape, np.float32)
    for name, draw in _CREASES.items():
        for side in "RL":
            amount = float(actions.get(f"{name}_{side}", 0.0))
            if rng.random() < _FALSE:
                amount = max(amount, rng.uniform(0.0, 0.6))
            elif rng.random() > _SHOWN:
                continue
            if amount > 0.1:
                for curve in draw(landmarks, unit, side, rng):
                    _carve(relief, curve, unit, amount * rng.uniform(0.2, 0.7), rng)
    return np.clip(image * (1.0 + relief), 0, 255).astype(np.uint8)


def _carve(relief: np.ndarray, curve: np.ndarray, unit: float, depth: float, rng: np.random.Generator) -> None:
    """Darken along a curve, and lighten beside it, as light from above does."""
    width = max(1, round(unit * rng.uniform(0.006, 0.02)))
    soft = unit * rng.uniform(0.006, 0.018)
    across = np.diff(curve[[0, -1]], axis=0)[0]
    normal = np.array([-across[1], across[0]]) / max(float(np.hypot(*across)), 1e-6)
    normal *= np.sign(normal[1]) or 1.0
    for shift, strength in ((0.0, -0.45), (1.8 * width + unit * 0.008, 0.15)):
        mask = np.zeros(relief.shape, np.uint8)
        line(mask, curve + shift * normal, width)
        relief += depth * strength / 255.0 * cv2.GaussianBlur(mask, (0, 0), soft).astype(np.float32) * 1.5


def _arc(a: np.ndarray, b: np.ndarray, bulge: float, rng: np.random.Generator, unit: float) -> np.ndarray:
    """A curve (9, 2) from a to b that bends aside by `bulge` of its length, slightly uneven."""
    t = np.linspace(0.0, 1.0, 9)[:, None]
    across = b - a
    normal = np.array([-across[1], across[0]])
    return a + t * across + 4.0 * bulge * t * (1 - t) * normal + rng.normal(0, 0.003 * unit, (9, 2))


def _sides(side: str, right: int, left: int) -> int:
    return int(from_ibug((right if side == "R" else left,))[0])


def _outwards(side: str) -> float:
    return -1.0 if side == "R" else 1.0


def _nose(points: np.ndarray, unit: float, side: str, rng: np.random.Generator) -> list[np.ndarray]:
    """Lines down the side of the nose, and a deeper fold beside its wing."""
    out = _outwards(side)
    curves = []
    for _ in range(rng.integers(2, 5)):
        t = rng.uniform(0.0, 1.0)
        root = points[27] * (1 - t) + points[29] * t + unit * np.array([out * rng.uniform(0.01, 0.05), 0.0])
        curves.append(
            _arc(root, root + unit * np.array([out * rng.uniform(0.05, 0.13), rng.uniform(-0.1, 0.01)]), 0.1, rng, unit)
        )
    wing = points[_sides(side, 31, 35)]
    corner = points[_sides(side, 48, 54)]
    top = wing + unit * np.array([out * 0.07, -0.06])
    curves.append(_arc(top, 0.5 * (wing + corner) + unit * np.array([out * 0.12, 0.0]), -0.1 * out, rng, unit))
    return curves


def _glabella(points: np.ndarray, unit: float, side: str, rng: np.random.Generator) -> list[np.ndarray]:
    """Upright lines between the brows."""
    inner = points[_sides(side, 21, 22)]
    middle = 0.5 * (points[21] + points[22])
    curves = []
    for _ in range(rng.integers(1, 3)):
        foot = middle + rng.uniform(0.15, 0.8) * (inner - middle) + unit * np.array([0.0, 0.03])
        curves.append(
            _arc(foot, foot + unit * np.array([rng.normal(0, 0.015), -rng.uniform(0.08, 0.16)]), 0.05, rng, unit)
        )
    return curves


def _forehead(points: np.ndarray, unit: float, side: str, rng: np.random.Generator) -> list[np.ndarray]:
    """Lines across the forehead, above a brow."""
    brow = points[17:22] if side == "R" else points[22:27]
    curves = []
    height = rng.uniform(0.08, 0.14)
    for _ in range(rng.integers(2, 5)):
        curves.append(
            _arc(brow[1] - (0, height * unit), brow[4 if side == "R" else 3] - (0, height * unit), 0.05, rng, unit)
        )
        height += rng.uniform(0.05, 0.1)
    return curves


def _crows_feet(points: np.ndarray, unit: float, side: str, rng: np.random.Generator) -> list[np.ndarray]:
    """Lines from the outer corner of an eye, and a pouch below it."""
    out = _outwards(side)
    corner, lower = points[_sides(side, 36, 45)], points[_sides(side, 41, 46)]
    inner = points[_sides(side, 39, 42)]
    curves = []
    for _ in range(rng.integers(2, 5)):
        start = corner + unit * np.array([out * 0.03, rng.uniform(-0.04, 0.05)])
        curves.append(
            _arc(
                start,
                start + unit * np.array([out * rng.uniform(0.06, 0.14), rng.uniform(-0.08, 0.06)]),
                0.05,
                rng,
                unit,
            )
        )
    drop = unit * rng.uniform(0.05, 0.11)
    curves.append(_arc(inner + (0, drop), corner + (0, 0.7 * drop), 0.12 * (lower[1] > inner[1]), rng, unit))
    return curves


def _cheek_fold(points: np.ndarray, unit: float, side: str, rng: np.random.Generator) -> list[np.ndarray]:
    """The fold from the wing of the nose round the corner of the mouth, which a smile deepens."""
    out = _outwards(side)
    wing, corner = points[_sides(side, 31, 35)], points[_sides(side, 48, 54)]
    return [
        _arc(
            wing + unit * np.array([out * 0.05, 0.0]),
            corner + unit * np.array([out * 0.08, 0.05]),
            -0.15 * out,
            rng,
            unit,
        )
    ]


def _lip_corner(points: np.ndarray, unit: float, side: str, rng: np.random.Generator) -> list[np.ndarray]:
    """A short fold at the corner of the mouth, and a bulge below the lower lip."""
    out = _outwards(side)
    corner = points[_sides(side, 48, 54)] + unit * np.array([out * rng.uniform(0.02, 0.05), 0.0])
    below = points[57] + unit * np.array([out * rng.uniform(0.0, 0.12), rng.uniform(0.04, 0.08)])
    return [
        _arc(corner - (0, 0.04 * unit), corner + (0, rng.uniform(0.03, 0.08) * unit), -0.2 * out, rng, unit),
        _arc(below, below + unit * np.array([out * 0.1, -0.01]), 0.1, rng, unit),
    ]


_CREASES: dict[str, Callable[..., list[np.ndarray]]] = {
    "noseSneer": _nose,
    "browDown": _glabella,
    "browInnerUp": _forehead,
    "cheekSquint": _crows_feet,
    "mouthSmile": _cheek_fold,
    "mouthPress": _lip_corner,
}
