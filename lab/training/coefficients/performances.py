"""Performances of random scripts by people whose photos became the skins of heads, with the acted coefficients."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from facemime.core.face.landmarks import JAW
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.takes.take import Take, TakeRecorder, describe
from facemime.core.tracking.pdm import PointDistributionModel
from facemime.core.tracking.tracker import FaceTracker

from ..tracker.heads import IctHead
from ..tracker.organs import Eyes, random_eyes
from ..tracker.reproject import WINDOW_LIGHT, Scene, SkinnedHead, render, skin_head
from ..tracker.sources import Photo
from ..tracker.wrinkles import crease
from .script import ict_weights, random_script, script_at

_SIZE, _EYES, _NOISE = 400, 100.0, 3.0
"""Side of an image and distance between the outer corners of the eyes in pixels, and noise in grey levels."""
_SWAY, _RATES = np.radians([4.0, 14.0, 4.0]), np.array([1.3, 1.05, 0.8])
_BLINKS, _BLINK = 2.3, 0.24
"""Seconds between blinks, and duration of a blink."""


@dataclass(frozen=True)
class Performer:
    """A person who can be rendered."""

    head: IctHead
    skinned: SkinnedHead
    number: int


def performer(head: IctHead, model: PointDistributionModel, photo: Photo, number: int) -> Performer:
    """The person of a photo, reduced to slightly more than its rendered size, as rendering samples single pixels."""
    shrink = min(1.5 * _EYES / photo.eye_distance(), 1.0)
    grey = cv2.resize(photo.grey(), None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    points = (photo.landmarks + 0.5) * shrink - 0.5
    return Performer(head, skin_head(head, model, grey, points, acting=not photo.by_hand), number)


def perform(person: Performer, seconds: float, fps: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield images (S, S) uint8 of a person's random script, and the coefficients (52,) that each shows.

    The person blinks now and then, looks straight ahead and moves the head a little.
    """
    rng = np.random.default_rng((person.number, 211))
    acts = random_script(seconds, rng)
    eyes, phases = random_eyes(rng), rng.uniform(0.0, 2.0 * np.pi, 3)
    eyes = replace(eyes, gaze=np.zeros((2, 2)))
    for frame in range(round(seconds * fps)):
        time = frame / fps
        keys = script_at(acts, time)
        blinking = _bump(time % _BLINKS - 0.5 * _BLINKS)
        for side in ("Left", "Right"):
            _blink(keys, side, blinking)
        pose = np.array([_EYES, *(_SWAY * np.sin(_RATES * time + phases)), *[(_SIZE - 1) / 2.0] * 2])
        pose[4:] += 9.0 * np.sin(0.9 * time + phases[0]), 6.0 * np.sin(1.7 * time + phases[1])
        yield _picture(person, keys, pose, eyes, rng), keys


def _picture(person: Performer, keys: np.ndarray, pose: np.ndarray, eyes: Eyes, rng: np.random.Generator) -> np.ndarray:
    """Return an image (S, S) uint8 of a person who acts `keys` in front of the background of the photo."""
    head, skinned = person.head, person.skinned
    weights, tongue = ict_weights(head, keys, skinned.blink)
    scene = Scene(WINDOW_LIGHT, 0.06, tongue=(0.8, 0.8), tongue_out=tongue, eyes=eyes)
    drawn = render(head, skinned, weights, pose, _SIZE, scene, rng)
    corners = skinned.uv[head.landmarks][JAW], drawn.landmarks[JAW].astype(np.float32)
    move, _ = cv2.estimateAffinePartial2D(*corners, method=cv2.LMEDS)
    behind = cv2.warpAffine(skinned.skin, move, (_SIZE, _SIZE), borderMode=cv2.BORDER_REPLICATE)
    behind = behind * (WINDOW_LIGHT.ambient + 0.5 * WINDOW_LIGHT.strength)
    edge = cv2.GaussianBlur(drawn.covered.astype(np.float32), (0, 0), 0.8)
    image = np.where(drawn.covered, drawn.image * edge + behind * (1.0 - edge), behind).clip(0, 255).astype(np.uint8)
    shown = dict(zip(head.names, weights.tolist(), strict=True))
    image = crease(image, drawn.landmarks, _EYES, shown, np.random.default_rng((person.number, 3)))
    return np.clip(image + rng.normal(0.0, _NOISE, image.shape), 0, 255).astype(np.uint8)


def _blink(keys: np.ndarray, side: str, amount: float) -> None:
    """Shut an eye in place, where shut lids are not wide open as well."""
    shut = COEFFICIENT_INDEX["eyeBlink" + side]
    keys[shut] = max(keys[shut], amount)
    keys[COEFFICIENT_INDEX["eyeWide" + side]] *= 1.0 - amount


def _bump(away: float) -> float:
    """1 at 0, and 0 at half of `_BLINK`."""
    share = float(np.clip(1.5 - 3.0 * abs(away) / _BLINK, 0.0, 1.0))
    return share * share * (3.0 - 2.0 * share)


def tracked(tracker: FaceTracker, person: Performer, seconds: float, fps: float) -> tuple[Take, np.ndarray]:
    """Return the take of a person's performance, and the acted coefficients (N, 52)."""
    tracker.reset()
    recorder, acted = TakeRecorder(describe("performance", fps, (_SIZE, _SIZE), tracker.model_id)), []
    for frame, (image, keys) in enumerate(perform(person, seconds, fps)):
        recorder.append(frame / fps, tracker.track(image))
        acted.append(keys)
    return recorder.finish(), np.array(acted)
