"""Training images for the expert of actions: renders whose activations are exactly known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facemime.core.face.names import ACTIONS, N_ACTIONS, action_indices
from facemime.core.tracking.pdm import PointDistributionModel

from .dress import dress
from .heads import IctHead, bare_teeth, sample_expression, sample_speech, shut_lips
from .organs import random_eyes
from .reproject import Scene, SkinnedHead, render
from .samples import (
    SCALE,
    SIZE,
    Stack,
    composed,
    degrade,
    occlude,
    personal_expression,
    random_light,
    random_pose,
    skin_photo,
)
from .sources import Photo
from .wrinkles import crease

_SHARES: dict[str, tuple[float, float]] = {
    "cheekPuff": (0.25, 1.3),
    "noseSneer": (0.3, 1.2),
    "cheekSquint": (0.3, 1.2),
    "browInnerUp": (0.3, 1.5),
    "browDown": (0.3, 1.4),
}
"""Probability that a face shows an action on purpose, besides by chance, and its largest strength."""
_SEALED, _TONGUE, _SPOILT = 0.4, 0.2, 0.4
"""Shares of faces with shut lips that are pressed or rolled in, of those with a tongue, and of degraded images."""
_ONE_SIDED = 0.5
"""Share of two-sided actions that are shown on one side only, as it is harder to distinguish left from right than an
action from rest."""
_BRIGHT, _BARED = 0.7, 0.15
"""Shares of mouths that are bright inside, with or without a tongue, and of bared teeth, as both would otherwise be
mistaken for a tongue."""
_BROWS = ("browInnerUp", "browDown")
_PRESSED = action_indices(("mouthPressRight", "mouthPressLeft"))
_THINNER = 0.45
"""How far pressed lips are also rolled in."""
_LOOKS = 0.55
"""Angle in radians at which an eye turns its lids as far as an `eyeLook` expression at 1."""


@dataclass
class ActionSamples(Stack):
    """Training images, stacked.

    Attributes
    ----------
    images : (N, SIZE, SIZE) uint8
    landmarks : (N, 66, 2) float32
    poses : (N, 6) float32
    actions : (N, 15) float32
        In the order of `ACTIONS`.
    gaze : (N, 2, 2) float32
        As in `Eyes`; NaN where the eyes are the photo's.
    people : (N,) int32
        Equal for all pictures of a person.
    """

    images: np.ndarray
    landmarks: np.ndarray
    poses: np.ndarray
    actions: np.ndarray
    gaze: np.ndarray
    people: np.ndarray


def action_samples(
    head: IctHead,
    model: PointDistributionModel,
    photo: Photo,
    person: int,
    backgrounds: list[Photo],
    count: int,
    rng: np.random.Generator,
    resting: int = 0,
) -> ActionSamples:
    """Return `count` re-projections of one photo, the first `resting` of which show no expression."""
    skinned = skin_photo(head, model, photo, rng)
    rows = []
    for i in range(count):
        calm = i < resting
        expression, tongue, shown = np.zeros(len(head.names), np.float32), 0.0, np.zeros(N_ACTIONS)
        if not calm:
            expression, tongue, shown = _sample_actions(head, skinned, rng)
        eyes = random_eyes(rng) if rng.random() < 0.7 else None
        if eyes is not None:
            follow_gaze(head, expression, eyes.gaze)
        pose = random_pose(rng)
        pose[1:3] *= 0.75
        light = random_light(rng, darkest=0.35, brightest=0.9)
        brightness = (0.6, 1.2) if rng.random() < _BRIGHT else (0.35, 0.75)
        scene = Scene(light, rng.uniform(0, 0.12), (0.0, 0.0), brightness, tongue, eyes)
        picture = render(head, skinned, expression, pose, SIZE, scene, rng)
        image = composed(picture, skinned, head, backgrounds, rng)
        image = crease(image, picture.landmarks, SCALE, dict(zip(head.names, expression, strict=True)), rng)
        if not tongue:  # hair on the lip would cover it
            image = dress(image, picture.landmarks, SCALE, rng)
        if rng.random() < 0.04:
            image, _ = occlude(image, picture.landmarks, rng, 0.6)
        if rng.random() < _SPOILT:
            image = degrade(image, rng)
        gaze = np.full((2, 2), np.nan) if eyes is None else eyes.gaze
        rows.append((image, picture.landmarks, pose, shown, gaze, person))
    images, points, poses, actions, gazes, people = zip(*rows, strict=True)
    return ActionSamples(
        np.stack(images),
        np.float32(points),
        np.float32(poses),
        np.float32(actions),
        np.float32(gazes),
        np.int32(people),
    )


def _activations(head: IctHead, expression: np.ndarray, tongue: float) -> np.ndarray:
    """Activations (15,) of an expression (E,) and a tongue, in the order of `ACTIONS`."""
    return np.array(
        [tongue if name == "tongueOut" else float(expression[head.index(_ict_name(name))]) for name in ACTIONS]
    )


def _ict_name(name: str) -> str:
    """ICT-FaceKit's name of an action."""
    if name.endswith("Right"):
        return name.removesuffix("Right") + "_R"
    return name.removesuffix("Left") + "_L" if name.endswith("Left") else name


def _sample_actions(
    head: IctHead, skinned: SkinnedHead, rng: np.random.Generator
) -> tuple[np.ndarray, float, np.ndarray]:
    """Return a random expression (E,) with frequent actions, how far the tongue is out, and activations (15,)."""
    weights = personal_expression(head, skinned, rng, sample_speech if rng.random() < 0.25 else sample_expression)
    for name, (share, strength) in _SHARES.items():
        if rng.random() < share:
            amount = strength * rng.uniform(0.2, 1.0)
            sides = rng.uniform(0.8, 1.0, 2)
            if rng.random() < _ONE_SIDED:
                sides[rng.integers(2)] = rng.uniform(0.0, 0.3)
            weights[head.both(name)] = amount * sides
            if name == "cheekSquint":
                weights[head.both("cheekRaiser")] = amount * sides * rng.uniform(0.3, 1.0)
    if max(weights[head.both("cheekPuff")]) > 0.3 or rng.random() < _SEALED:
        _seal(head, weights, rng)
    tongue = 0.0
    if rng.random() < _BARED:
        bare_teeth(head, weights, rng, 0.7)
    elif rng.random() < _TONGUE:
        tongue = rng.uniform(0.15, 1.0)
        for name in ("mouthRollLower", "mouthRollUpper", "mouthPress_L", "mouthPress_R", "mouthClose"):
            weights[head.index(name)] = 0.0
        weights[head.both("cheekPuff")] *= 0.2
        weights[head.index("jawOpen")] = max(weights[head.index("jawOpen")], rng.uniform(0.15, 0.5))
    brows = [head.both(name) for name in _BROWS]
    if all(weights[each].any() for each in brows) and rng.random() < 0.8:  # both at once look like neither
        weights[brows[rng.integers(2)]] = 0.0
    shown = _activations(head, weights, tongue)
    _thin_pressed_lips(head, weights)
    weights[head.index("mouthShrugLower")] += 0.3 * rng.random() * shown[_PRESSED].mean()
    return weights, tongue, shown


def posed(head: IctHead, actions: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the expression (E,) and tongue of a face that shows only the given actions (15,)."""
    weights = np.zeros(len(head.names), np.float32)
    tongue = 0.0
    for name, amount in zip(ACTIONS, actions.tolist(), strict=True):
        if name == "tongueOut":
            tongue = amount
            weights[head.index("jawOpen")] = 0.3 * amount
        else:
            weights[head.index(_ict_name(name))] = amount
            if name.startswith("cheekSquint"):
                weights[head.index(_ict_name(name).replace("Squint", "Raiser"))] = 0.6 * amount
    _thin_pressed_lips(head, weights)
    return weights, tongue


def _thin_pressed_lips(head: IctHead, weights: np.ndarray) -> None:
    """Roll pressed lips in a little, in place, as ICT-FaceKit's expression hardly shows that they become thinner."""
    pressed = 0.5 * (weights[head.index("mouthPress_R")] + weights[head.index("mouthPress_L")])
    weights[[head.index("mouthRollLower"), head.index("mouthRollUpper")]] += _THINNER * pressed


def _seal(head: IctHead, weights: np.ndarray, rng: np.random.Generator) -> None:
    """Shut the lips, and press or roll them in, in place."""
    shut_lips(head, weights)
    kind = rng.random()
    if kind < 0.45:
        sides = rng.uniform(0.85, 1.0, 2)
        if rng.random() < _ONE_SIDED:
            sides[rng.integers(2)] = rng.uniform(0.0, 0.2)
        weights[head.both("mouthPress")] = rng.uniform(0.4, 1.3) * sides
    if 0.35 < kind < 0.8:
        both, amount = rng.random(), rng.uniform(0.3, 1.2)
        weights[head.index("mouthRollLower")] = amount * (both < 0.8)
        weights[head.index("mouthRollUpper")] = amount * rng.uniform(0.7, 1.0) * (both > 0.2)


def follow_gaze(head: IctHead, weights: np.ndarray, gaze: np.ndarray) -> None:
    """Let the lids follow the eyes, in place."""
    for (pitch, yaw), side, outwards in zip(gaze, "RL", (1.0, -1.0), strict=True):
        turned = {"Down": pitch, "Up": -pitch, "Out": outwards * yaw, "In": -outwards * yaw}
        for way, angle in turned.items():
            weights[head.index(f"eyeLook{way}_{side}")] = max(float(angle), 0.0) / _LOOKS
