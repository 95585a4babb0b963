"""Random scripts: which ARKit keys a rendered performer acts at which time, and by how much.

An act is a plausible expression: at most one movement per part of the face, usually equal on both sides, eased in and
out as muscles move. Left and right are the performer's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS

from ..tracker.heads import IctHead

_PARTS: tuple[tuple[float, tuple[tuple[float, dict[str, tuple[float, float]]], ...]], ...] = (
    (
        0.45,  # brows
        (
            (3, {"browInnerUp": (0.4, 1.0), "browOuterUp": (0.4, 1.0)}),
            (2, {"browDown": (0.4, 1.0)}),
            (1, {"browInnerUp": (0.4, 1.0)}),
            (1, {"browOuterUp": (0.4, 1.0)}),
        ),
    ),
    (
        0.40,  # lids
        (
            (2, {"eyeBlink": (0.5, 1.0)}),
            (1, {"eyeWide": (0.4, 1.0)}),
            (1, {"eyeSquint": (0.4, 1.0)}),
        ),
    ),
    (
        0.30,  # nose and cheeks
        (
            (1, {"noseSneer": (0.4, 1.0)}),
            (1, {"cheekSquint": (0.4, 1.0)}),
            (1, {"cheekPuff": (0.5, 1.0)}),
        ),
    ),
    (
        0.85,  # mouth and jaw
        (
            (2, {"jawOpen": (0.3, 1.0)}),
            (1, {"jawOpen": (0.4, 0.8), "mouthLowerDown": (0.3, 0.8), "mouthUpperUp": (0.0, 0.6)}),
            (1, {"jawOpen": (0.4, 0.9), "mouthClose": (0.3, 0.7)}),
            (1, {"jawOpen": (0.3, 0.4), "tongueOut": (0.7, 1.0)}),
            (1, {"jawOpen": (0.2, 0.6), "mouthFunnel": (0.4, 1.0)}),
            (2, {"mouthSmile": (0.4, 1.0)}),
            (1, {"mouthSmile": (0.4, 1.0), "mouthUpperUp": (0.2, 0.7), "mouthLowerDown": (0.0, 0.7)}),
            (1, {"mouthSmile": (0.4, 1.0), "jawOpen": (0.2, 0.7)}),
            (1, {"mouthDimple": (0.4, 1.0)}),
            (2, {"mouthFrown": (0.4, 1.0)}),
            (1, {"mouthFrown": (0.4, 1.0), "mouthShrugLower": (0.3, 0.8)}),
            (1, {"mouthShrugLower": (0.4, 1.0), "mouthShrugUpper": (0.0, 0.8)}),
            (1, {"mouthShrugUpper": (0.4, 1.0)}),
            (2, {"mouthPucker": (0.4, 1.0)}),
            (1, {"mouthFunnel": (0.4, 1.0), "mouthPucker": (0.0, 0.6)}),
            (1, {"mouthStretch": (0.4, 1.0)}),
            (1, {"mouthPress": (0.4, 1.0)}),
            (1, {"mouthRollLower": (0.4, 1.0)}),
            (1, {"mouthRollUpper": (0.4, 1.0)}),
            (1, {"mouthUpperUp": (0.4, 1.0)}),
            (1, {"mouthLowerDown": (0.4, 1.0)}),
            (1, {"mouthLeft": (0.4, 1.0)}),
            (1, {"mouthRight": (0.4, 1.0)}),
            (1, {"jawLeft": (0.4, 1.0), "jawOpen": (0.0, 0.4)}),
            (1, {"jawRight": (0.4, 1.0), "jawOpen": (0.0, 0.4)}),
            (1, {"jawForward": (0.5, 1.0)}),
        ),
    ),
)
"""Parts of the face: the probability that one acts, and its movements with their odds and the range of each key."""
_EMOTIONS: tuple[dict[str, tuple[float, float]], ...] = (
    {"mouthSmile": (0.4, 1.0), "cheekSquint": (0.2, 0.9), "eyeSquint": (0.0, 0.6), "mouthUpperUp": (0.0, 0.5)},
    {"browInnerUp": (0.3, 1.0), "browDown": (0.0, 0.5), "mouthFrown": (0.3, 1.0), "mouthShrugLower": (0.0, 0.7)},
    {"browInnerUp": (0.4, 1.0), "browOuterUp": (0.4, 1.0), "eyeWide": (0.2, 1.0), "jawOpen": (0.0, 0.7)},
    {"browInnerUp": (0.3, 0.9), "eyeWide": (0.3, 1.0), "mouthStretch": (0.3, 1.0), "jawOpen": (0.0, 0.5)},
    {"browDown": (0.4, 1.0), "eyeSquint": (0.2, 0.8), "mouthPress": (0.3, 1.0)},
    {"noseSneer": (0.4, 1.0), "mouthUpperUp": (0.2, 0.8), "eyeSquint": (0.0, 0.6), "mouthFrown": (0.0, 0.6)},
    {"mouthSmile": (0.2, 0.5), "mouthDimple": (0.3, 0.9)},
)
"""Prototypes of joy, sadness, surprise, fear, anger, disgust and contempt, after Friesen & Ekman's EMFACS."""
_SOUNDS: tuple[tuple[float, dict[str, tuple[float, float]]], ...] = (
    (3, {"jawOpen": (0.2, 0.6), "mouthLowerDown": (0.0, 0.4), "mouthUpperUp": (0.0, 0.3)}),  # a
    (3, {"jawOpen": (0.05, 0.3), "mouthStretch": (0.0, 0.4), "mouthLowerDown": (0.1, 0.5), "mouthUpperUp": (0.0, 0.3)}),
    (1, {"jawOpen": (0.05, 0.3), "mouthSmile": (0.1, 0.4), "mouthDimple": (0.0, 0.3), "mouthLowerDown": (0.0, 0.4)}),
    (2, {"jawOpen": (0.03, 0.25), "mouthPucker": (0.4, 1.0), "mouthFunnel": (0.0, 0.4)}),  # u, w
    (2, {"jawOpen": (0.15, 0.45), "mouthFunnel": (0.3, 0.8), "mouthPucker": (0.2, 0.6)}),  # o
    (1, {"jawOpen": (0.05, 0.2), "mouthFunnel": (0.3, 0.8), "mouthPucker": (0.2, 0.7), "mouthShrugUpper": (0.0, 0.3)}),
    (2, {"mouthPress": (0.0, 0.5), "mouthRollLower": (0.0, 0.4), "mouthRollUpper": (0.0, 0.3)}),  # m, b, p
    (1, {"jawOpen": (0.03, 0.15), "mouthRollLower": (0.2, 0.6), "mouthUpperUp": (0.1, 0.4)}),  # f, v
    (3, {"jawOpen": (0.05, 0.2), "mouthLowerDown": (0.1, 0.4), "mouthStretch": (0.0, 0.2)}),  # t, d, s
)
"""What the mouth does for the sounds of speech, with their odds."""
_TALKING = 0.5
"""Share of acts that are phrases."""
_SOUND, _MOODY = (0.1, 0.3), 0.5
"""Duration of a sound in seconds, and share of phrases during which the upper face or the corners of the mouth act."""
_MOODS: tuple[dict[str, tuple[float, float]], ...] = (
    {"mouthSmile": (0.1, 0.6), "cheekSquint": (0.0, 0.4)},
    {"browInnerUp": (0.2, 0.9), "browOuterUp": (0.2, 0.9)},
    {"browDown": (0.2, 0.9), "eyeSquint": (0.0, 0.5)},
    {"mouthFrown": (0.1, 0.6), "browInnerUp": (0.0, 0.6)},
)
"""What accompanies a phrase."""
_EMOTIONAL = 0.35
"""Share of acts that are emotions; the others combine parts of the face by chance."""
_ONE_SIDED = 0.25

_THINNER = 0.45
"""How far pressed lips are also rolled in, as in `acting`."""
_REST, _ATTACK, _PAUSE = 1.0, (0.12, 0.32), (0.0, 0.3)
_LENGTH = (0.6, 1.1)


@dataclass(frozen=True)
class RandomAct:
    """Keys (52,) at their peak, start and end in seconds, and duration in seconds of rise and fall."""

    start: float
    end: float
    attack: float
    keys: np.ndarray


def random_script(seconds: float, rng: np.random.Generator) -> list[RandomAct]:
    """Return acts that fill `seconds`, after a second of rest."""
    acts, time = [], _REST
    while time + _LENGTH[1] < seconds:
        length = rng.uniform(*_LENGTH)
        if rng.random() < _TALKING:
            length = min(2.0 * length, seconds - time)
            acts += _phrase(time, time + length, rng)
        else:
            acts.append(RandomAct(time, time + length, rng.uniform(*_ATTACK), random_expression(rng)))
        time += length + rng.uniform(*_PAUSE)
    return acts


def random_moment(rng: np.random.Generator) -> np.ndarray:
    """Coefficients of a random expression, or of a moment of a phrase, (52,)."""
    if rng.random() >= _TALKING:
        return random_expression(rng)
    keys = _sound(rng)
    return np.maximum(keys, _mood(rng)) if rng.random() < _MOODY else keys


def _sound(rng: np.random.Generator) -> np.ndarray:
    odds = np.array([odds for odds, _ in _SOUNDS], dtype=float)
    keys = np.zeros(len(COEFFICIENTS))
    _act(keys, _SOUNDS[rng.choice(len(_SOUNDS), p=odds / odds.sum())][1], rng)
    return keys


def _mood(rng: np.random.Generator) -> np.ndarray:
    keys = np.zeros(len(COEFFICIENTS))
    _act(keys, _MOODS[rng.integers(len(_MOODS))], rng)
    return keys


def _phrase(start: float, end: float, rng: np.random.Generator) -> list[RandomAct]:
    """Return sounds that follow one another and overlap, and what accompanies them."""
    acts, time = [], start
    while time < end:
        length = rng.uniform(*_SOUND)
        acts.append(RandomAct(time - 0.3 * length, time + 1.3 * length, 0.6 * length, _sound(rng)))
        time += length
    if rng.random() < _MOODY:
        mood = _mood(rng)
        acts.append(RandomAct(start, end, rng.uniform(*_ATTACK), mood))
    return acts


def script_at(acts: list[RandomAct], time: float) -> np.ndarray:
    """Coefficients at `time`, (52,)."""
    keys = np.zeros(len(COEFFICIENTS))
    for act in acts:
        t = float(np.clip(min(time - act.start, act.end - time) / act.attack, 0.0, 1.0))
        keys = np.maximum(keys, t * t * (3.0 - 2.0 * t) * act.keys)
    return keys


def random_expression(rng: np.random.Generator) -> np.ndarray:
    """Coefficients of a random plausible expression, (52,)."""
    keys = np.zeros(len(COEFFICIENTS))
    if rng.random() < _EMOTIONAL:
        _act(keys, _EMOTIONS[rng.integers(len(_EMOTIONS))], rng)
    while not keys.any():
        for share, movements in _PARTS:
            if rng.random() < share:
                odds = np.array([odds for odds, _ in movements], dtype=float)
                chosen = movements[rng.choice(len(movements), p=odds / odds.sum())][1]
                _act(keys, chosen, rng)
    if keys[COEFFICIENT_INDEX["cheekPuff"]] > 0.0:  # air escapes through open lips
        keys[[COEFFICIENT_INDEX[name] for name in ("jawOpen", "mouthFunnel", "tongueOut", "mouthClose")]] = 0.0
    return keys


def _act(keys: np.ndarray, movement: dict[str, tuple[float, float]], rng: np.random.Generator) -> None:
    """Add a movement, in place."""
    single = rng.integers(2) if rng.random() < _ONE_SIDED else -1
    for name, (low, high) in movement.items():
        amount = rng.uniform(low, high)
        if name in COEFFICIENT_INDEX:
            keys[COEFFICIENT_INDEX[name]] = amount
            continue
        for side, word in enumerate(("Left", "Right")):
            share = rng.uniform(0.85, 1.0) if single < 0 else float(side == single)
            keys[COEFFICIENT_INDEX[name + word]] = amount * share


def ict_weights(head: IctHead, keys: np.ndarray, blink: dict[str, float]) -> tuple[np.ndarray, float]:
    """Expression (E,) of ICT-FaceKit and tongue for coefficients (52,), for a person whose eyes shut at `blink`."""
    weights = np.zeros(len(head.names), np.float32)
    for name, amount in zip(COEFFICIENTS, keys.tolist(), strict=True):
        for key in ict_names(head, name):
            weights[head.index(key)] += amount * (blink[key[-1]] if name.startswith("eyeBlink") else 1.0)
    for side, word in (("L", "Left"), ("R", "Right")):  # as in `acting.posed`
        weights[head.index(f"cheekRaiser_{side}")] += 0.6 * keys[COEFFICIENT_INDEX["cheekSquint" + word]]
    pressed = 0.5 * (keys[COEFFICIENT_INDEX["mouthPressLeft"]] + keys[COEFFICIENT_INDEX["mouthPressRight"]])
    weights[[head.index("mouthRollLower"), head.index("mouthRollUpper")]] += _THINNER * pressed
    return weights, float(keys[COEFFICIENT_INDEX["tongueOut"]])


def ict_names(head: IctHead, name: str) -> list[str]:
    """ICT-FaceKit's expressions that make up a coefficient; none for the tongue's."""
    for word in ("Left", "Right"):
        sided = name.removesuffix(word) + "_" + word[0]
        if name.endswith(word) and sided in head.names:
            return [sided]
    return [key for key in (name, f"{name}_L", f"{name}_R") if key in head.names]
