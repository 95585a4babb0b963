"""Tongues and eyes for training pictures, which photos do not show as needed: a tongue that is out, and eyes that look
in a known direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facemime.core.base.rotation import euler_to_matrix

_ALONG, _AROUND = 14, 16
_UPPER, _LOWER = 61, 64
"""Middles of the inner rims of the lips among the 66 landmarks."""


@dataclass(frozen=True)
class Tongue:
    """A tongue as a mesh: vertices (N, 3) float32 in the head frame, triangles (M, 3) that face outwards."""

    vertices: np.ndarray
    triangles: np.ndarray


def tongue_out(landmarks: np.ndarray, amount: float, rng: np.random.Generator) -> Tongue:
    """A tongue between the lips of a head with `landmarks` (66, 3), out by `amount` of 0 to 1, hanging in any way."""
    upper, lower = landmarks[_UPPER], landmarks[_LOWER]
    gap = max(float(lower[1] - upper[1]), 0.0)
    thick = min(rng.uniform(0.08, 0.15), max(1.3 * gap, 0.05)) / 2.0
    half = rng.uniform(0.12, 0.2) * (0.75 + 0.25 * amount)
    between = np.array([lower[0], lower[1] - thick * rng.uniform(0.6, 1.0), min(upper[2], lower[2]) + 0.02])
    length = rng.uniform(0.07, 0.12) + 0.4 * amount
    droop, aside = rng.uniform(-0.2, 0.6) + 1.2 * rng.random() * amount, rng.normal(0.0, 0.15)
    # From inside the mouth to the lips, then in an arc that turns by `droop` towards the chin.
    t = np.linspace(0.0, 1.0, _ALONG)
    inside = t < 0.35
    out = np.clip((t - 0.35) / 0.65, 0.0, 1.0)
    bend = np.cumsum(np.cos(droop * out)) - np.cumsum(np.cos(droop * out))[inside.sum() - 1]
    fall = np.cumsum(np.sin(droop * out)) - np.cumsum(np.sin(droop * out))[inside.sum() - 1]
    step = length / max(float((~inside).sum()), 1.0)
    path = np.stack(
        [
            np.where(inside, 0.0, aside * out * length),
            np.where(inside, 0.04 * (0.35 - t), fall * step),
            np.where(inside, 0.9 * (0.35 - t), -bend * step),
        ],
        axis=1,
    )
    # A flat ellipse around the path, with a groove on top, that ends in a half circle.
    end = np.sqrt(np.clip(1.0 - np.square(np.clip((out - 0.45) / 0.55, 0.0, 1.0)), 0.0, 1.0))
    angle = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    groove = 1.0 - rng.uniform(0.0, 0.9) * np.exp(-np.square(np.cos(angle) / 0.3)) * (np.sin(angle) < 0)
    across = np.zeros((_AROUND, 3))
    across[:, 0], across[:, 1] = half * np.cos(angle), thick * np.sin(angle) * groove
    tilt = droop * out
    rows = []
    for centre, scale, turn in zip(path, end, tilt, strict=True):
        rows.append(between + centre + scale * across @ euler_to_matrix(float(turn), 0.0, 0.0).T)
    ring = np.arange(_AROUND)
    quads = []
    for i in range(_ALONG - 1):
        a, b = i * _AROUND + ring, i * _AROUND + np.roll(ring, -1)
        quads += [np.stack([a, a + _AROUND, b], 1), np.stack([b, a + _AROUND, b + _AROUND], 1)]
    triangles = np.concatenate(quads).astype(np.int32)
    return Tongue(np.concatenate(rows).astype(np.float32), triangles)


@dataclass(frozen=True)
class Eyes:
    """Painted eyes.

    Attributes
    ----------
    gaze : (2, 2) float64
        `(pitch, yaw)` of the performer's right and left eye, radians, with the signs of `TrackResult`.
    white, iris, pupil : float
        Grey of sclera, iris and pupil; that of the sclera relative to the skin.
    rims : (float, float)
        Angles of the rims of pupil and iris from the axis of the eye, radians.
    shadow : float
        How much darker an eye is below its upper lid.
    glint : (3,) float64
        Direction of the light that is mirrored.
    """

    gaze: np.ndarray
    white: float
    iris: float
    pupil: float
    rims: tuple[float, float]
    shadow: float
    glint: np.ndarray

    def paint(self, side: int, places: np.ndarray, ball: np.ndarray, level: float) -> np.ndarray:
        """Grey (F,) of places (F, 3) on the eyeball with vertices `ball` (B, 3), for skin of grey `level`."""
        centre = 0.5 * (ball.min(0) + ball.max(0))
        radius = 0.5 * float(np.ptp(ball[:, 1]))
        away = places - centre
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
        pitch, yaw = self.gaze[side]
        axis = euler_to_matrix(pitch, yaw, 0.0) @ (0.0, 0.0, -1.0)
        angle = np.arccos(np.clip(away @ axis, -1.0, 1.0))
        white = min(self.white * level, 245.0)
        soft = 0.03
        in_iris = 1.0 / (1.0 + np.exp(np.clip((angle - self.rims[1]) / soft, -30, 30)))
        in_pupil = 1.0 / (1.0 + np.exp(np.clip((angle - self.rims[0]) / soft, -30, 30)))
        ring = 1.0 - 0.35 * np.exp(-np.square((angle - self.rims[1]) / 0.06))
        grey = white + in_iris * (self.iris * ring - white)
        grey = grey + in_pupil * (self.pupil - grey)
        grey = grey * (1.0 - self.shadow * np.clip(0.5 - (places[:, 1] - centre[1]) / (0.8 * radius), 0.0, 1.0))
        spark = np.exp(-np.square(np.arccos(np.clip(away @ self.glint, -1.0, 1.0)) / 0.06))
        return grey + spark * (235.0 - grey)


def random_eyes(rng: np.random.Generator) -> Eyes:
    """Eyes of any colour that look anywhere together or, occasionally, at the nose."""
    spread = 0.15 if rng.random() < 0.6 else 0.35
    together = np.clip(rng.normal(0.0, spread, 2) * (0.6, 1.0), (-0.45, -0.6), (0.45, 0.6))
    gaze = np.tile(together, (2, 1)) + rng.normal(0.0, 0.015, (2, 2))
    inwards = rng.uniform(0.1, 0.5) if rng.random() < 0.15 else rng.normal(0.02, 0.02)
    gaze[:, 1] += (-inwards, inwards)
    iris = rng.uniform(20.0, 70.0) if rng.random() < 0.5 else rng.uniform(70.0, 150.0)
    glint = np.array([rng.normal(0.0, 0.2), rng.normal(-0.15, 0.15), -1.0])
    rim = rng.uniform(0.36, 0.46)
    return Eyes(
        gaze=gaze,
        white=rng.uniform(0.85, 1.5),
        iris=iris,
        pupil=rng.uniform(5.0, 0.5 * iris + 10.0),
        rims=(rim * rng.uniform(0.3, 0.6), rim),
        shadow=rng.uniform(0.0, 0.6),
        glint=glint / np.linalg.norm(glint),
    )
