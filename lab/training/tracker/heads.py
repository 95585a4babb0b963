"""The ICT-FaceKit head: identities and expressions, in the tracker's axes and units."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from facemime.core.face.landmarks import IBUG68_INDICES, OUTER_EYE_CORNERS

from ..data import ICT_FILE

FACE = slice(0, 9409)
"""Vertices of the face's skin; skull and neck, sockets, gums, teeth and eyes follow (ICT-FaceKit's order)."""
EYEBALLS = (slice(23021, 24591), slice(21451, 23021))
"""Vertices of the performer's right and left eyeball, of `IctHead`."""


@dataclass(frozen=True)
class IctHead:
    """Blendshape head in the head frame, lengths in outer-eye distances of the neutral.

    Attributes
    ----------
    neutral : (V, 3) float32
    identity : (100, V, 3) float32
        One standard deviation each.
    expression : (E, V, 3) float32
    names : list of str
        Of the expressions.
    triangles : (T, 3) int32
    material : (T,) int
    materials : list of str
    landmarks : (66,) int
        Vertex indices.
    """

    neutral: np.ndarray
    identity: np.ndarray
    expression: np.ndarray
    names: list[str]
    triangles: np.ndarray
    material: np.ndarray
    materials: list[str]
    landmarks: np.ndarray

    def index(self, name: str) -> int:
        """Index of the expression `name`."""
        return self.names.index(name)

    def both(self, name: str, sides: str = "RL") -> list[int]:
        """Indices of the expression `name` of both sides, in that order."""
        return [self.index(f"{name}_{side}") for side in sides]


def load_ict(data: Path) -> IctHead:
    """Read ICT-FaceKit, converting its axes from y up, z to the camera, to y down, z away."""
    raw = np.load(data / ICT_FILE, allow_pickle=False)
    landmarks = raw["landmarks68"][IBUG68_INDICES]
    flip = np.array([1.0, -1.0, -1.0], np.float32)
    neutral = raw["neutral"] * flip
    corners = neutral[landmarks[OUTER_EYE_CORNERS]]
    unit = float(np.linalg.norm(corners[0] - corners[1]))
    centre = neutral[landmarks].mean(0)
    quads = raw["faces"]
    is_triangle = (quads[:, 3] < 0) | (quads[:, 3] == quads[:, 2])
    second = quads[~is_triangle][:, [0, 2, 3]]
    return IctHead(
        neutral=(neutral - centre) / unit,
        identity=raw["identity_delta"].astype(np.float32) * flip / unit,
        expression=raw["expression_delta"].astype(np.float32) * flip / unit,
        names=[str(n) for n in raw["expression_names"]],
        triangles=np.concatenate([quads[:, :3], second]).astype(np.int32),
        material=np.concatenate([raw["face_material"], raw["face_material"][~is_triangle]]),
        materials=[str(m) for m in raw["materials"]],
        landmarks=landmarks,
    )


# How often a sampled face shows an action, and the shapes that make it. Every action that users look at
# (blink, jaw, pucker, smile, brows) is frequent, although rare in photographs. Strengths above 1 are those of people
# who pull faces: with 1 at most, brows raised by more than a tenth of an eye distance were taken for the lids below.
_ACTIONS: tuple[tuple[float, tuple[str, ...], float], ...] = (
    (0.40, ("eyeBlink_L", "eyeBlink_R"), 1.0),
    (0.40, ("jawOpen",), 1.3),
    (0.30, ("mouthSmile_L", "mouthSmile_R"), 1.25),
    (0.15, ("mouthPucker",), 1.25),
    (0.12, ("mouthFunnel",), 1.25),
    (0.12, ("mouthFrown_L", "mouthFrown_R"), 1.25),
    (0.25, ("browDown_L", "browDown_R"), 1.4),
    (0.25, ("browInnerUp_L", "browInnerUp_R"), 1.7),
    (0.25, ("browOuterUp_L", "browOuterUp_R"), 1.7),
    (0.12, ("eyeSquint_L", "eyeSquint_R"), 1.0),
    (0.15, ("eyeWide_L", "eyeWide_R"), 1.8),
    (0.12, ("eyeLookDown_L", "eyeLookDown_R"), 1.0),
    (0.05, ("eyeLookUp_L", "eyeLookUp_R"), 1.0),
    (0.14, ("mouthStretch_L", "mouthStretch_R"), 1.2),
    (0.12, ("mouthUpperUp_L", "mouthUpperUp_R"), 0.9),
    (0.12, ("mouthLowerDown_L", "mouthLowerDown_R"), 0.9),
    (0.08, ("mouthRollLower",), 0.8),
    (0.08, ("mouthRollUpper",), 0.8),
    (0.08, ("mouthShrugLower",), 0.8),
    (0.08, ("mouthShrugUpper",), 0.8),
    (0.08, ("mouthPress_L", "mouthPress_R"), 0.8),
    (0.08, ("mouthDimple_L", "mouthDimple_R"), 0.8),
    (0.08, ("noseSneer_L", "noseSneer_R"), 0.8),
    (0.08, ("cheekSquint_L", "cheekSquint_R"), 0.8),
    (0.06, ("cheekPuff_L", "cheekPuff_R"), 0.8),
    (0.08, ("jawLeft",), 1.2),
    (0.08, ("jawRight",), 1.2),
    (0.06, ("jawForward",), 0.7),
    (0.10, ("mouthLeft",), 1.8),
    (0.10, ("mouthRight",), 1.8),
)

_GRIN = {
    "mouthSmile": (0.4, 1.0),
    "mouthUpperUp": (0.2, 0.8),
    "mouthLowerDown": (0.0, 0.9),
    "cheekSquint": (0.0, 0.8),
    "eyeSquint": (0.0, 0.8),
}
_SURPRISE = {
    "browInnerUp": (0.5, 1.8),
    "browOuterUp": (0.5, 1.8),
    "eyeWide": (0.2, 1.8),
}
"""Smiles that show the teeth, and surprise, need several simultaneous actions, which chance alone would seldom
combine."""


_BARED = 0.35
"""Share of speaking mouths with the teeth together, as in s and ch."""
_SHUT = 0.25
"""Share of those with the lips together, as in m and p."""
_OPENERS = (
    "jawOpen",
    "mouthFunnel",
    "mouthClose",
    "mouthUpperUp_L",
    "mouthUpperUp_R",
    "mouthLowerDown_L",
    "mouthLowerDown_R",
)
"""Expressions that part the lips."""
_CLOSERS = (
    "mouthClose",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthPress_L",
    "mouthPress_R",
)
"""Expressions that need shut lips, or shut them."""


def sample_speech(head: IctHead, rng: np.random.Generator) -> np.ndarray:
    """Random coefficients (E,) of a mouth that speaks or sings, while the rest of the face acts."""
    weights = sample_expression(head, rng)
    kind = rng.random()
    if kind < _BARED:
        bare_teeth(head, weights, rng, 0.12)
        return weights
    if kind < _BARED + _SHUT:
        shut_lips(head, weights)
        return weights
    weights[head.index("mouthClose")] = 0.0
    weights[head.index("jawOpen")] = rng.uniform(0.08, 1.3)
    for name, probability in (("mouthLowerDown", 0.4), ("mouthUpperUp", 0.3), ("mouthStretch", 0.2)):
        if rng.random() < probability:
            weights[head.both(name)] = rng.random()
    if rng.random() < 0.3:
        weights[head.index("mouthFunnel")] = rng.random()
    return weights


def bare_teeth(head: IctHead, weights: np.ndarray, rng: np.random.Generator, jaw: float) -> None:
    """Draw the lips apart before the teeth in place, the jaw open by up to `jaw`."""
    weights[[head.index(name) for name in _CLOSERS]] = 0.0
    weights[head.both("cheekPuff")] = 0.0
    weights[head.index("jawOpen")] = rng.uniform(0.0, jaw)
    weights[head.both("mouthLowerDown")] = rng.uniform(0.1, 1.1) * rng.uniform(0.8, 1.0, 2)
    weights[head.both("mouthUpperUp")] = rng.uniform(0.0, 1.0) * rng.uniform(0.8, 1.0, 2)
    shape = rng.random()
    if shape < 0.35:
        weights[head.both("mouthStretch")] = rng.uniform(0.0, 0.7)
    elif shape < 0.6:
        weights[head.both("mouthSmile")] = rng.uniform(0.0, 0.9) * rng.uniform(0.7, 1.0, 2)
    elif shape < 0.75:
        weights[head.index("mouthFunnel")] = rng.uniform(0.0, 0.6)
    elif shape < 0.85:
        weights[head.index("mouthPucker")] = rng.uniform(0.0, 0.5)


def shut_lips(head: IctHead, weights: np.ndarray) -> None:
    """Take away in place what parts the lips."""
    weights[[head.index(name) for name in _OPENERS]] = 0.0


def sample_expression(head: IctHead, rng: np.random.Generator) -> np.ndarray:
    """Random coefficients (E,): a few simultaneous actions, usually equal on both sides."""
    weights = np.zeros(len(head.names), np.float32)
    if rng.random() < 0.2:
        for name, (low, high) in _GRIN.items():
            weights[head.both(name)] = rng.uniform(low, high)
        weights[head.index("jawOpen")] = rng.uniform(0.0, 0.35)
        if rng.random() < 0.6:
            return weights
    surprised = rng.random() < 0.15
    for probability, shapes, strength in _ACTIONS:
        if rng.random() >= probability:
            continue
        # Half of all blinks are complete, as lids are seldom seen half way.
        amount = 1.0 if shapes[0] == "eyeBlink_L" and rng.random() < 0.5 else strength * rng.random()
        sides = np.ones(len(shapes))
        if len(shapes) == 2 and not shapes[0].startswith("eyeLook") and rng.random() < 0.3:
            sides[rng.integers(2)] = 0.0
        elif len(shapes) == 2:
            sides -= 0.25 * rng.random(2)
        for side, name in zip(sides, shapes, strict=True):
            weights[head.index(name)] = amount * side
    if surprised:
        for name, (low, high) in _SURPRISE.items():
            weights[head.both(name, "LR")] = rng.uniform(low, high) * rng.uniform(0.8, 1.0, 2)
    # "mouthClose" brings the lips together over an open jaw; alone it would push them through each other.
    if rng.random() < 0.2:
        weights[head.index("mouthClose")] = weights[head.index("jawOpen")] * rng.random()
    for side in "LR":  # wide open and closed lids exclude each other
        blink, wide = head.index(f"eyeBlink_{side}"), head.index(f"eyeWide_{side}")
        weights[wide] *= weights[blink] < 0.1
    return weights
