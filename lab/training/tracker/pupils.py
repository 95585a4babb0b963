"""Training images for the expert of the pupils: eyes that look in known directions, and photos of eyes.

Renders are exact, and their eyes look anywhere; photos show what no renderer paints, such as the reflections of
windows. An image is `EYES` pixels square, upright, around both eyes, with `SCALE` pixels per outer-eye distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.tracking.experts import crop_part
from facemime.core.tracking.pdm import PointDistributionModel

from .acting import follow_gaze
from .crops import covered, spoilt_source
from .dress import dress
from .heads import EYEBALLS, IctHead, sample_expression
from .organs import Eyes, random_eyes
from .reproject import Scene, SkinnedHead, render
from .samples import SCALE, SIZE, Stack, composed, degrade, personal_expression, random_light, random_pose, skin_photo
from .sources import Photo

EYES = 128
_OPEN = 0.12
"""Opening of an eye, as a share of its width, below which its pupil is not learnt."""
_LIGHT_IRIS = 0.3
"""Share of irises that are nearly as bright as the white, with a dark rim."""
_SHINING = 0.5
"""Share of images of eyes with more reflections than the one of the renderer."""
_RENDERED, _FRAMES = 0.45, 0.2
"""Shares of renders, and of frames of clips, in a batch; all others are photos."""
_SPOILT = 0.4
"""Share of images that are degraded, and of those with something in front or noise: fine detail tells where one
looks."""


@dataclass
class PupilSamples(Stack):
    """Training images, stacked.

    Attributes
    ----------
    images : (N, EYES, EYES) uint8
    eyes : (N, 2, 6, 2) float32
        Landmarks of the right and the left eye, where the tracker would find them.
    pupils : (N, 2, 2) float32
        NaN where an eye is shut.
    """

    images: np.ndarray
    eyes: np.ndarray
    pupils: np.ndarray


def pupil_samples(
    head: IctHead,
    model: PointDistributionModel,
    photo: Photo,
    backgrounds: list[Photo],
    count: int,
    rng: np.random.Generator,
) -> PupilSamples:
    """Return `count` re-projections of one photo with painted eyes."""
    skinned = skin_photo(head, model, photo, rng)
    rows = []
    for _ in range(count):
        eyes = _eyes_of_any_colour(rng)
        expression = personal_expression(head, skinned, rng, sample_expression)
        expression[head.both("eyeBlink")] *= rng.random() < 0.3
        follow_gaze(head, expression, eyes.gaze)
        pose = random_pose(rng)
        scene = Scene(random_light(rng, darkest=0.35, brightest=0.9), rng.uniform(0, 0.12), eyes=eyes)
        picture = render(head, skinned, expression, pose, SIZE, scene, rng)
        image = composed(picture, skinned, head, backgrounds, rng)
        pupils = _pupils(skinned, pose, scene, eyes)
        if rng.random() < _SHINING:
            image = _reflections(image, pupils, rng)
        image = dress(image, picture.landmarks, SCALE, rng)
        rows.append(eyes_of(degrade(image, rng), picture.landmarks, pupils))
    images, outlines, found = zip(*rows, strict=True)
    return PupilSamples(np.stack(images), np.float32(outlines), np.float32(found))


def eyes_of(image: np.ndarray, landmarks: np.ndarray, pupils: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut a row of `PupilSamples` out of an upright image at `SCALE`, with landmarks (66, 2) and pupils (2, 2)."""
    outlines = landmarks[[EYE_RIGHT, EYE_LEFT]]
    corner = np.round(outlines.mean((0, 1)) - EYES / 2)
    to = np.array([[1.0, 0.0, -corner[0]], [0.0, 1.0, -corner[1]]])
    cut = cv2.warpAffine(image, to, (EYES, EYES), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    width = np.linalg.norm(outlines[:, 3] - outlines[:, 0], axis=1)
    opening = np.linalg.norm(outlines[:, [1, 2]] - outlines[:, [5, 4]], axis=2).mean(1)
    shown = np.where((opening > _OPEN * width)[:, None], pupils - corner, np.nan)
    return cut, outlines - corner, shown


@dataclass(frozen=True)
class PupilBatch:
    """Images (B, 1, H, W), places of the pupils (B, 2, 2) as of `PupilNetwork`, and whether each is known (B, 2).

    All are float32.
    """

    pictures: np.ndarray
    pupils: np.ndarray
    known: np.ndarray


class PupilCrops:
    """Draws batches from samples by kind: "renders", "photos" and "clips", of which the last may be missing."""

    def __init__(self, samples: Mapping[str, PupilSamples], rng: np.random.Generator) -> None:
        self._samples, self._rng = samples, rng

    def batch(self, count: int, scale: float, size: tuple[int, int]) -> PupilBatch:
        """Draw the eyes of `count` faces, mirrored or not, approximately where the tracker finds them."""
        rng = self._rng
        pictures = np.empty((count, 1, *size[::-1]), np.float32)
        places = np.empty((count, 2, 2))
        for row in range(count):
            fate = rng.random()
            kind = "renders" if fate < _RENDERED else "clips" if fate < _RENDERED + _FRAMES else "photos"
            samples = self._samples.get(kind, self._samples["photos"])
            i = rng.integers(len(samples))
            image, eyes, pupils = samples.images[i], samples.eyes[i], samples.pupils[i].astype(np.float64)
            if kind == "photos" and rng.random() < _SPOILT:
                image = degrade(image, rng)
            if rng.random() < _SPOILT:
                image = spoilt_source(image, rng)
            pose = np.array([SCALE, 0.0, 0.0, rng.normal(0, 0.05), *eyes.mean((0, 1))])
            pose[0] *= np.exp(rng.normal(0, 0.06))
            pose[4:6] += rng.normal(0, 0.02, 2) * SCALE
            picture = crop_part(image, pose, scale, size)
            if rng.random() < _SPOILT:
                picture = covered(picture, rng, 0.1)
            c, s = np.cos(pose[3]), np.sin(pose[3])
            place = (pupils - pose[4:6]) @ np.array([[c, -s], [s, c]]) * (scale / pose[0] / size[1])
            if rng.random() < 0.5:
                picture, place = picture[:, ::-1], place[::-1] * (-1.0, 1.0)
            pictures[row, 0], places[row] = picture, place
        known = np.isfinite(places).all(axis=2)
        return PupilBatch(pictures, np.float32(np.nan_to_num(places)), np.float32(known))


def _eyes_of_any_colour(rng: np.random.Generator) -> Eyes:
    eyes = random_eyes(rng)
    if rng.random() < _LIGHT_IRIS:
        iris = rng.uniform(120.0, 200.0)
        eyes = replace(eyes, iris=iris, pupil=rng.uniform(5.0, 90.0), white=eyes.white * rng.uniform(1.0, 1.2))
    return eyes


def _pupils(skinned: SkinnedHead, pose: np.ndarray, scene: Scene, eyes: Eyes) -> np.ndarray:
    """Centres of the pupils (2, 2) in the image."""
    places = []
    for ball, (pitch, yaw) in zip(EYEBALLS, eyes.gaze, strict=True):
        vertices = skinned.neutral[ball]
        radius = 0.5 * float(np.ptp(vertices[:, 1]))
        ahead = euler_to_matrix(pitch, yaw, 0.0) @ (0.0, 0.0, -1.0)
        places.append(0.5 * (vertices.min(0) + vertices.max(0)) + radius * ahead)
    turned = np.array(places) @ euler_to_matrix(*pose[1:4]).T
    shown: np.ndarray = pose[0] * turned[:, :2] / (1.0 + scene.perspective * turned[:, 2:]) + pose[4:6]
    return shown


def _reflections(image: np.ndarray, pupils: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw reflections of lamps and windows, alike on both eyes."""
    light = np.zeros(image.shape, np.float32)
    for _ in range(int(rng.integers(1, 4))):
        aside = rng.normal(0.0, 0.035, 2) * SCALE
        axes = rng.uniform(0.005, 0.025, 2) * SCALE
        angle, strength = rng.uniform(0, 180), rng.uniform(0.4, 1.0)
        for pupil in pupils:
            mask = np.zeros(image.shape, np.uint8)
            centre = np.round((pupil + aside) * 16).astype(int).tolist()
            reach = np.maximum(np.round(axes * 16), 1).astype(int).tolist()
            cv2.ellipse(mask, centre, reach, angle, 0, 360, 255, -1, cv2.LINE_AA, 4)
            light = np.maximum(light, mask.astype(np.float32) * (strength / 255.0))
    light = cv2.GaussianBlur(light, (0, 0), 0.6)
    out: np.ndarray = (image + light * (245.0 - image)).astype(np.uint8)
    return out
