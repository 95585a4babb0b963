"""Images of held-out people with exact landmarks: stills that vary in one respect, and clips.

Photos of people who were not used for training become the skins of rendered heads, as in
`lab.training.tracker.reproject`. All heads have the same size, the same place in the image and no expression, except
for what an axis varies. Rendered images are kept below build/.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from facemime.core.face.landmarks import JAW
from facemime.core.face.names import ACTIONS
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.tracker import FaceTracker
from lab.training.data import ROOT
from lab.training.tracker.acting import posed
from lab.training.tracker.heads import IctHead, load_ict
from lab.training.tracker.organs import random_eyes
from lab.training.tracker.reproject import WINDOW_LIGHT, Light, Scene, SkinnedHead, render, skin_head
from lab.training.tracker.sources import HAND_LABELLED, Photo, read_photos, split
from lab.training.tracker.wrinkles import crease

VERSION = 1
"""Version of the images; raising it renders them again."""
SIZE = 400
EYES = 100.0
"""Pixels between the outer corners of the eyes, unless the size varies."""
FPS = 25.0
_CENTRE = (SIZE - 1) / 2.0

LIMITS = (25.0, 45.0, 40.0)
"""Limits of pitch, yaw and roll in degrees within which a face should never be lost."""
_ACT = 18
"""Number of frames of each action in an acting clip."""
_TURNS_PER_SECOND = np.array([0.31, 0.23, 0.17])

_EXPRESSIONS: dict[str, dict[str, float]] = {
    "neutral": {},
    "blink": {"eyeBlink": 1.0},
    "wink": {"eyeBlink_L": 1.0},
    "smile": {"mouthSmile": 0.9, "cheekSquint": 0.4},
    "grin": {"mouthSmile": 0.8, "mouthUpperUp": 0.6, "mouthLowerDown": 0.5, "cheekSquint": 0.5, "jawOpen": 0.1},
    "jaw": {"jawOpen": 0.8},
    "pucker": {"mouthPucker": 1.0},
    "frown": {"mouthFrown": 0.8, "browDown": 0.8},
    "brows": {"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.6},
}

AXES: dict[str, tuple[str, tuple[float | str, ...]]] = {
    "yaw": ("degrees", (0, 10, 20, 30, 40, 50, 60)),
    "pitch": ("degrees, down is positive", (-30, -20, -10, 0, 10, 20, 30)),
    "roll": ("degrees", (0, 10, 20, 30, 40, 50, 70, 90)),
    "expression": ("", tuple(_EXPRESSIONS)),
    "side light": ("share of all light", (0.0, 0.3, 0.6, 0.8, 0.95)),
    "darkness": ("exposure", (1.0, 0.5, 0.25, 0.12, 0.06)),
    "blur": ("sigma, % of the eye distance", (0.0, 1.0, 2.0, 3.0, 4.5, 6.0)),
    "noise": ("grey levels", (0, 5, 10, 20, 30)),
    "compression": ("JPEG quality", (90, 50, 30, 20, 10, 5)),
    "occlusion": ("% of face height or width", (0, 10, 20, 30, 40, 50)),
    "size": ("pixels between the eyes", (140, 100, 70, 50, 35, 25, 18)),
    "combined": ("share of the maximum", (0.2, 0.4, 0.6, 0.8, 1.0)),
}
"""Varied quantities, their units and values. Yaw, roll, light and covers alternate between sides."""


def shown_size(axis: str, value: float | str) -> float:
    """Pixels between the outer eye corners at a value of an axis."""
    if axis == "size":
        return float(value)
    return EYES - 60.0 * float(value) if axis == "combined" else EYES


@dataclass(frozen=True)
class Stills:
    """Images at one value of an axis, one per person: (N, H, W) uint8, landmarks (N, 66, 2) in pixels."""

    images: list[np.ndarray]
    landmarks: np.ndarray


@dataclass(frozen=True)
class Clip:
    """A clip with exact landmarks: frames, landmarks (T, 66, 2) in pixels, times (T,) in seconds."""

    name: str
    frames: list[np.ndarray]
    landmarks: np.ndarray
    times: np.ndarray


@dataclass(frozen=True)
class ActingClip:
    """Frames, the exact activations (T, 15) of `ACTIONS`, and vergence (T,) in radians."""

    frames: list[np.ndarray]
    actions: np.ndarray
    vergence: np.ndarray


class ExactFaces:
    """Renders images, and caches them in `folder`."""

    folder = ROOT / "build" / "bench" / "exact" / f"v{VERSION}"

    def __init__(self, data: Path, people: int) -> None:
        self.data, self.people = data, people
        self._cast: list[SkinnedHead] | None = None
        self._head: IctHead | None = None

    def stills(self, axis: str) -> dict[float | str, Stills]:
        """Return all images of an axis, by value."""
        values = AXES[axis][1]
        return {value: self._kept(f"{axis}-{value}", lambda v=value: self._pictures(axis, v)) for value in values}

    def clip(self, person: int) -> Clip:
        """Return six seconds of a person who blinks, speaks and turns the head, with the noise of a webcam."""
        kept = self._kept(f"clip-{person}", lambda: zip(*self._performance(person), strict=True))
        times = np.arange(len(kept.images)) / FPS
        return Clip(f"re-projected {person}", kept.images, kept.landmarks, times)

    def turning(self, person: int) -> Clip:
        """Return eight seconds in which a person turns, nods and tilts the head to the limits."""
        kept = self._kept(f"turning-{person}", lambda: zip(*self._turns(person), strict=True))
        return Clip(f"turning {person}", kept.images, kept.landmarks, np.arange(len(kept.images)) / FPS)

    def acting(self, person: int) -> ActingClip:
        """Return a person who rests, then shows one action after the other, and finally crosses the eyes."""
        path = self.folder / f"acting-{person}-{self.people}.npz"
        if not path.exists():
            images, actions, vergence = zip(*self._acts(person), strict=True)
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_suffix(".part.npz")
            np.savez(unfinished, images=np.stack(images), actions=np.stack(actions), vergence=np.array(vergence))
            unfinished.replace(path)
        with np.load(path, allow_pickle=False) as kept:
            return ActingClip(list(kept["images"]), kept["actions"], kept["vergence"])

    def _kept(self, name: str, make: Callable[[], Iterator[tuple]]) -> Stills:
        path = self.folder / f"{name.replace(' ', '_')}-{self.people}.npz"
        if not path.exists():
            images, landmarks = make()
            path.parent.mkdir(parents=True, exist_ok=True)
            unfinished = path.with_suffix(".part.npz")
            np.savez(unfinished, images=np.stack(images), landmarks=np.stack(landmarks))
            unfinished.replace(path)
        with np.load(path, allow_pickle=False) as kept:
            return Stills(list(kept["images"]), kept["landmarks"])

    def _pictures(self, axis: str, value: float | str) -> Iterator[tuple]:
        return zip(*(self._picture(person, axis, value) for person in range(self.people)), strict=True)

    def _picture(self, person: int, axis: str, value: float | str) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng((person, len(axis)))
        side = 1.0 if person % 2 else -1.0
        pose = np.array([EYES, 0.0, 0.0, 0.0, _CENTRE, _CENTRE])
        light, expression = Light(1.0, 0.0, np.array([0.0, 0.0, -1.0])), "neutral"
        if axis in ("yaw", "pitch", "roll"):
            column = ("pitch", "yaw", "roll").index(axis) + 1
            pose[column] = np.radians(float(value)) * (1.0 if axis == "pitch" else side)
        elif axis == "expression":
            expression = str(value)
        elif axis == "side light":
            towards = np.array([0.95 * side, -0.1, -0.3])
            light = Light(1.0 - float(value), 1.3 * float(value), towards / np.linalg.norm(towards))
        elif axis == "size" and float(value) > EYES:
            pose[0] = float(value)
        elif axis == "combined":
            return self._hard(person, float(value), pose, side)
        image, landmarks = self._shown(person, _EXPRESSIONS[expression], pose, light)
        if axis in _DEGRADE:
            image, landmarks = _DEGRADE[axis](image, landmarks, float(value), person, rng)
        return image, landmarks

    def _hard(self, person: int, share: float, pose: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray]:
        """Render a person turned, lit from the side, small, blurred, noisy and compressed, by a share of the maxima."""
        rng = np.random.default_rng((person, 5))
        pose[1:4] = np.radians([25.0, 45.0, 30.0]) * share * np.array([rng.choice([-1, 1]), side, rng.choice([-1, 1])])
        actions = {k: v * min(1.0, 1.5 * share) for k, v in _EXPRESSIONS[str(rng.choice(list(_EXPRESSIONS)))].items()}
        towards = np.array([0.95 * side, -0.3, -0.3])
        light = Light(1.0 - 0.7 * share, 0.9 * share, towards / np.linalg.norm(towards))
        image, landmarks = self._shown(person, actions, pose, light)
        image, landmarks = _blurred(image, landmarks, 1.5 * share, person, rng)
        image, landmarks = _shrunk(image, landmarks, shown_size("combined", share), person, rng)
        image, landmarks = _noisy(image, landmarks, 10.0 * share, person, rng)
        return _packed(image, landmarks, 90 - 65 * share, person, rng)

    def _shown(
        self, person: int, actions: dict[str, float], pose: np.ndarray, light: Light
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return an image of a person in front of the background of the same photo."""
        weights = self._weights(self.cast[person], actions)
        return self._staged(person, weights, pose, Scene(light, 0.06))

    def _staged(
        self, person: int, weights: np.ndarray, pose: np.ndarray, scene: Scene
    ) -> tuple[np.ndarray, np.ndarray]:
        head, skinned, light = self.head, self.cast[person], scene.light
        rng = np.random.default_rng(person)
        drawn = render(head, skinned, weights, pose, SIZE, scene, rng)
        source = skinned.uv[head.landmarks]
        matrix, _ = cv2.estimateAffinePartial2D(source[JAW], drawn.landmarks[JAW].astype(np.float32), method=cv2.LMEDS)
        shrink = float(np.hypot(*matrix[:, 0]))
        soft = cv2.GaussianBlur(skinned.skin, (0, 0), max(0.5 / shrink - 0.3, 0.1))
        behind = cv2.warpAffine(soft, matrix, (SIZE, SIZE), borderMode=cv2.BORDER_REPLICATE)
        behind = behind * (light.ambient + 0.5 * light.strength)
        edge = cv2.GaussianBlur(drawn.covered.astype(np.float32), (0, 0), 0.8)
        image = np.where(drawn.covered, drawn.image * edge + behind * (1 - edge), behind)
        return np.clip(image, 0, 255).astype(np.uint8), drawn.landmarks

    def _weights(self, skinned: SkinnedHead, actions: dict[str, float]) -> np.ndarray:
        weights = np.zeros(len(self.head.names), np.float32)
        for name, amount in actions.items():
            for key in (name,) if name in self.head.names else (f"{name}_L", f"{name}_R"):
                if key in self.head.names:
                    shut = skinned.blink[key[-1]] if key.startswith("eyeBlink") else 1.0
                    weights[self.head.index(key)] = amount * shut
        return weights

    def _performance(self, person: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        rng = np.random.default_rng((person, 77))
        for frame in range(int(6 * FPS)):
            t, actions = frame / FPS, performed(frame)
            angles = np.radians([5 * np.sin(1.3 * t), 18 * np.sin(1.05 * t + person), 4 * np.sin(0.7 * t)])
            place = _CENTRE + np.array([9 * np.sin(0.9 * t), 6 * np.sin(1.7 * t)])
            pose = np.array([EYES, *angles, *place])
            image, landmarks = self._shown(person, actions, pose, WINDOW_LIGHT)
            yield _noisy(image, landmarks, 3.0, person, rng)

    def _acts(self, person: int) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
        rng = np.random.default_rng((person, 103))
        head = self.head
        paired = [name.removesuffix("Right") for name in ACTIONS if name.endswith("Right")]
        shows = [[name] for name in ACTIONS] + [[name + side for side in ("Right", "Left")] for name in paired]
        ahead = random_eyes(rng)
        for turn, names in enumerate([*[[]] * 2, *(shows[i] for i in rng.permutation(len(shows))), ["crossed"]]):
            for frame in range(_ACT):
                t = (turn * _ACT + frame) / FPS
                amount = _pulse(frame / _ACT, 0.5, 0.9)
                actions = np.zeros(len(ACTIONS))
                actions[[ACTIONS.index(name) for name in names if name in ACTIONS]] = amount
                inwards = 0.3 * amount * ("crossed" in names)
                gaze = np.array([[0.0, -inwards], [0.0, inwards]]) + [0.05 * np.sin(t), 0.15 * np.sin(0.8 * t)]
                weights, tongue = posed(head, actions)
                blink = _pulse(t % 2.3, 1.5, 0.24)
                for side in "RL":
                    weights[head.index(f"eyeBlink_{side}")] = blink * self.cast[person].blink[side]
                angles = np.radians([4 * np.sin(1.3 * t), 14 * np.sin(1.05 * t + person), 4 * np.sin(0.7 * t)])
                pose = np.array([EYES, *angles, *(_CENTRE + np.array([9 * np.sin(0.9 * t), 6 * np.sin(1.7 * t)]))])
                scene = Scene(WINDOW_LIGHT, 0.06, tongue=(0.8, 0.8), tongue_out=tongue, eyes=replace(ahead, gaze=gaze))
                image, points = self._staged(person, weights, pose, scene)
                shown = dict(zip(head.names, weights, strict=True))
                image = crease(image, points, EYES, shown, np.random.default_rng((person, turn)))
                yield _noisy(image, points, 3.0, person, rng)[0], actions, 2.0 * inwards

    def _turns(self, person: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        rng = np.random.default_rng((person, 91))
        phases = rng.uniform(0.0, 2.0 * np.pi, 3)
        for frame in range(int(8 * FPS)):
            t = frame / FPS
            angles = min(1.0, t) * np.radians(LIMITS) * np.sin(2.0 * np.pi * _TURNS_PER_SECOND * t + phases)
            actions = {"jawOpen": max(0.0, 0.5 * np.sin(7.0 * t)), "eyeBlink": float(t % 1.7 < 0.16)}
            actions["mouthSmile"] = 0.6 * (np.sin(t) > 0)
            place = _CENTRE + np.array([9 * np.sin(0.9 * t), 6 * np.sin(1.7 * t)])
            image, landmarks = self._shown(person, actions, np.array([EYES, *angles, *place]), WINDOW_LIGHT)
            yield _noisy(image, landmarks, 3.0, person, rng)

    @property
    def head(self) -> IctHead:
        """The mesh."""
        if self._head is None:
            self._head = load_ict(self.data)
        return self._head

    @property
    def cast(self) -> list[SkinnedHead]:
        """The people, spread evenly over the held-out ones."""
        if self._cast is None:
            model = FaceTracker.load().pdm
            photos = split(read_photos(self.data, *HAND_LABELLED))[1]
            chosen = [photos[i] for i in np.linspace(0, len(photos) - 1, self.people).round().astype(int)]
            self._cast = [_skinned(self.head, model, photo) for photo in chosen]
        return self._cast


def _skinned(head: IctHead, model: PointDistributionModel, photo: Photo) -> SkinnedHead:
    """The head of a photo, reduced to slightly more than its rendered size, as rendering samples single pixels."""
    shrink = min(1.5 * EYES / photo.eye_distance(), 1.0)
    grey = cv2.resize(photo.grey(), None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    return skin_head(head, model, grey, (photo.landmarks + 0.5) * shrink - 0.5, acting=False)


def performed(frame: int) -> dict[str, float]:
    """Expressions of ICT-FaceKit, 0 to 1, that the person in `ExactFaces.clip` shows in a frame."""
    t = frame / FPS
    speech = _pulse(t, 3.5, 1.0) * (0.5 - 0.5 * np.cos(2 * np.pi * 4.0 * (t - 3.0)))
    brows = 0.8 * _pulse(t, 4.9, 0.8)
    return {
        "eyeBlink": max(_pulse(t, at, 0.24) for at in (0.9, 2.1, 2.6, 4.3, 5.3)),
        "jawOpen": 0.6 * speech,
        "mouthSmile": 0.7 * _pulse(t, 1.6, 1.0),
        "browInnerUp": brows,
        "browOuterUp": brows,
    }


def _pulse(t: float, at: float, width: float) -> float:
    """A smooth rise to 1 at `at` and back, `width` seconds wide and flat in the middle third."""
    share = np.clip(1.5 - 1.5 * abs(t - at) / (0.5 * width), 0.0, 1.0)
    return float(share * share * (3.0 - 2.0 * share))


_Changed = tuple[np.ndarray, np.ndarray]


def _dark(image: np.ndarray, points: np.ndarray, value: float, _: int, rng: np.random.Generator) -> _Changed:
    """Reduce the exposure; the sensor's noise of two grey levels remains."""
    return np.clip(image * value + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8), points


def _blurred(image: np.ndarray, points: np.ndarray, value: float, _: int, __: np.random.Generator) -> _Changed:
    return (cv2.GaussianBlur(image, (0, 0), value * EYES / 100.0) if value else image), points


def _noisy(image: np.ndarray, points: np.ndarray, value: float, _: int, rng: np.random.Generator) -> _Changed:
    return np.clip(image + rng.normal(0, value, image.shape), 0, 255).astype(np.uint8), points


def _packed(image: np.ndarray, points: np.ndarray, value: float, _: int, __: np.random.Generator) -> _Changed:
    _, stream = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(value)])
    return cv2.imdecode(stream, cv2.IMREAD_GRAYSCALE), points


def _shrunk(image: np.ndarray, points: np.ndarray, value: float, _: int, __: np.random.Generator) -> _Changed:
    """Reduce the image, and extend its border to the old size."""
    side = round(SIZE * min(value / EYES, 1.0))
    small = cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)
    before = (SIZE - side) // 2
    after = SIZE - side - before
    image = cv2.copyMakeBorder(small, before, after, before, after, cv2.BORDER_REPLICATE)
    return image, (points + 0.5) * (side / SIZE) - 0.5 + before


def _covered(image: np.ndarray, points: np.ndarray, value: float, person: int, rng: np.random.Generator) -> _Changed:
    """Cover the face from below, the left, the right or above by a slightly textured rectangle."""
    if value == 0:
        return image, points
    low, high = points.min(0), points.max(0)
    low[1] -= 0.25 * (high[1] - low[1])  # the forehead has no landmarks
    depth = value / 100.0 * (high - low)
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]].astype(np.float32)
    inside = (y > high[1] - depth[1], x < low[0] + depth[0], x > high[0] - depth[0], y < low[1] + depth[1])[person % 4]
    texture = cv2.GaussianBlur(rng.normal(0, 60, image.shape).astype(np.float32), (0, 0), 4.0) + rng.uniform(40, 200)
    soft = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 1.0)
    return np.clip(image * (1 - soft) + texture * soft, 0, 255).astype(np.uint8), points


_DEGRADE = {
    "darkness": _dark,
    "blur": _blurred,
    "noise": _noisy,
    "compression": _packed,
    "occlusion": _covered,
    "size": _shrunk,
}
