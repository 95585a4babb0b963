"""The skin's texture: tone, blood, pores, lips, lids, brows, stubble, hair and the shade of the folds."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from . import anatomy
from .canvas import FrontView, Image, Texels, cloud, distance_to_line, distance_to_outline, fade, mix, noise, rasterise
from .complexion import Complexion
from .cut import CAVITY, SOCKET
from .hair import beard_shade, brow_strokes, crop

SIZE = 2048
_SEED = 7

_STUBBLE = (0.530, 0.450, 0.420)
_MOUTH = (0.420, 0.150, 0.150)
_LASH = (0.110, 0.075, 0.065)


def paint_skin(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    uv: NDArray[np.float64],
    face_chart: NDArray[np.int64],
    values: NDArray[np.float64],
    points: NDArray[np.float64],
    landmarks: NDArray[np.float64],
    look: Complexion,
) -> NDArray[np.uint8]:
    """Paint the skin's texture, (SIZE, SIZE, 3) BGR.

    `values` (V, 2) are each vertex' openness and its share of ear; `face_chart` (F,) the faces' charts; `points` the
    vertices of hm08 and `landmarks` the 66 points, head frame, metres.
    """
    texels = rasterise(vertices, faces, uv, values, SIZE)
    image = _tone(texels, landmarks, look)
    chart = face_chart[texels.face]
    _paint_lids(image, texels.place, points, landmarks, look.lashes)
    _paint_lips(image, texels.place, points, look)
    _paint_hair(image, texels, landmarks, look)
    _paint_insides(image, texels.place, chart, landmarks)
    shade = np.clip((texels.value[..., 0] - 0.12) / 0.62, 0.0, 1.0) ** 0.75
    shade = cv2.GaussianBlur(shade, (0, 0), 3.0)
    image *= 1.0 - (1.0 - shade)[..., None] * np.float32([0.46, 0.58, 0.62])
    bgr = np.clip(image[..., ::-1], 0.0, 1.0) * 255.0 + 0.5
    return np.asarray(bgr.astype(np.uint8))


def _tone(texels: Texels, landmarks: NDArray[np.float64], look: Complexion) -> Image:
    place = texels.place
    image = np.empty((*place.shape[:2], 3), np.float32)
    image[:] = look.tone
    mottled = cloud(place, 0.030, 4, 1)
    mix(image, look.blood, np.clip(0.07 + 0.055 * mottled, 0.0, 1.0))
    for centre, radius, amount in _blushes(landmarks):
        mirrored = np.abs(place[..., 0])
        away = np.stack([mirrored - abs(centre[0]), place[..., 1] - centre[1], place[..., 2] - centre[2]], axis=-1)
        mix(image, look.blood, amount * np.exp(-((np.linalg.norm(away, axis=-1) / radius) ** 2)))
    mix(image, look.blood, 0.24 * texels.value[..., 1])
    forehead = np.exp(-(((place[..., 1] - landmarks[21, 1] + 0.028) / 0.02) ** 2)) * fade(place[..., 2], -0.05, -0.085)
    mix(image, look.bright, 0.30 * forehead)
    fine = noise(place, 0.0011, 21) * 0.6 + noise(place, 0.00055, 22)
    image *= 1.0 + (0.020 * fine + 0.018 * cloud(place, 0.008, 2, 23))[..., None]
    freckles = fade(noise(place, 0.0026, 24) * 0.5 + noise(place, 0.0065, 25) * 0.5, 0.52, 0.78)
    mix(image, (0.66, 0.455, 0.36), 0.12 * freckles * fade(place[..., 2], -0.045, -0.075))
    return image


def _folded(place: Image) -> Image:
    """Positions with the right half folded onto the left."""
    return np.concatenate([np.abs(place[..., :1]), place[..., 1:]], axis=-1)


def _blushes(landmarks: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], float, float]]:
    """Centre (left side), radius and strength of the reddest places: cheeks, nose, chin, the lids' outer ends."""
    cheek = (landmarks[45] + landmarks[54]) / 2.0 + [0.006, 0.0, 0.002]
    return [
        (cheek, 0.019, 0.26),
        (landmarks[30] + [0.0, 0.002, 0.0], 0.010, 0.30),
        (landmarks[35], 0.007, 0.26),
        (landmarks[8] + [0.0, -0.012, -0.004], 0.012, 0.16),
        ((landmarks[42] + landmarks[27]) / 2.0 + [0.004, 0.002, 0.004], 0.007, 0.20),
    ]


def _paint_lids(
    image: Image, place: Image, points: NDArray[np.float64], landmarks: NDArray[np.float64], lashes: float
) -> None:
    """Darker sockets, pink rims, and the line of the lashes."""
    mirrored = _folded(place)
    upper = distance_to_line(mirrored, points[[*anatomy.UPPER_LID_EDGE]])
    lower = distance_to_line(mirrored, points[[*anatomy.LOWER_LID_EDGE]])
    near = np.minimum(upper, lower)
    mix(image, (0.640, 0.430, 0.375), 0.42 * np.exp(-((upper / 0.0075) ** 2)))
    mix(image, (0.640, 0.420, 0.385), 0.30 * np.exp(-((lower / 0.0080) ** 2)))
    corner = np.linalg.norm(mirrored - landmarks[42].astype(np.float32), axis=-1)
    mix(image, (0.66, 0.36, 0.33), 0.50 * np.exp(-((corner / 0.0032) ** 2)))
    mix(image, (0.740, 0.470, 0.430), 0.55 * np.exp(-((near / 0.0012) ** 2)))
    mix(image, _LASH, 0.95 * fade(upper, 0.00115 * lashes, 0.00035 * lashes))
    mix(image, _LASH, 0.62 * fade(lower, 0.00070, 0.00015) * fade(mirrored[..., 0], landmarks[42, 0], landmarks[43, 0]))
    crease = np.abs(upper - 0.0042)
    above = fade(place[..., 1], landmarks[44, 1] + 0.001, landmarks[44, 1] - 0.001)
    mix(image, (0.46, 0.29, 0.25), 0.30 * above * np.exp(-((crease / 0.0009) ** 2)))


def _paint_lips(image: Image, place: Image, points: NDArray[np.float64], look: Complexion) -> None:
    upper, lower = points[[*anatomy.UPPER_LIP_BORDER]], points[[*anatomy.LOWER_LIP_BORDER]]
    half = np.concatenate([upper, lower[::-1][1:]])
    outline = np.concatenate([half, (half * [-1, 1, 1])[::-1]])
    inside = distance_to_outline(place, outline)
    ragged = inside + 0.00025 * noise(place, 0.0012, 31)
    depth = fade(place[..., 2], points[anatomy.MOUTH_CORNER, 2] + 0.004, points[anatomy.MOUTH_CORNER, 2])
    cover = fade(ragged, -0.0004, 0.0012) * depth
    line = points[[*anatomy.UPPER_LIP_LINE]]
    meeting = distance_to_line(_folded(place), line)
    furrows = noise(place * np.float32([1.0, 0.12, 0.3]), 0.00075, 32)
    tint = np.empty_like(image)
    tint[:] = look.lip
    tint *= 1.0 + (0.06 * furrows + 0.03 * noise(place, 0.004, 33))[..., None]
    upper_lip = fade(place[..., 1], line[0, 1] + 0.0004, line[0, 1] - 0.0004)
    tint *= 1.0 - 0.10 * upper_lip[..., None]
    mix(tint, look.lip_dark, 0.75 * np.exp(-((meeting / 0.0016) ** 2)))
    mix(image, tint, 0.86 * cover)
    corner = np.linalg.norm(_folded(place) - points[anatomy.MOUTH_CORNER].astype(np.float32), axis=-1)
    mix(image, (0.50, 0.28, 0.25), 0.55 * np.exp(-((corner / 0.0026) ** 2)))
    rim = np.exp(-(((inside + 0.0011) / 0.0008) ** 2)) * depth
    mix(image, (0.90, 0.72, 0.62), 0.16 * rim)


def _paint_hair(image: Image, texels: Texels, landmarks: NDArray[np.float64], look: Complexion) -> None:
    place = texels.place
    beard = look.beard * beard_shade(place, landmarks)
    dots = fade(noise(place, 0.00034, 41) + 0.5 * noise(place, 0.0007, 42), 0.20, 0.80)
    mix(image, _STUBBLE, beard * 0.20)
    mix(image, (0.34, 0.26, 0.23), beard * 0.20 * dots)
    view = FrontView((-0.075, -0.06), (0.075, 0.03), 0.00005)
    brow_strokes(view, landmarks[22:27, :2], look.brow, np.random.default_rng(_SEED))
    soft = FrontView((-0.075, -0.06), (0.075, 0.03), 0.00005)
    soft.ink = cv2.GaussianBlur(view.ink, (0, 0), 22.0)
    facing = fade(place[..., 2], -0.045, -0.060)
    mix(image, look.hair, 0.34 * np.clip(soft.look_up(place) * 1.3, 0.0, 1.0) * facing)
    mix(image, look.hair, 0.85 * np.clip(view.look_up(place), 0.0, 1.0) * facing)
    cover, shade = crop(place, texels.value[..., 1], look)
    tint = np.empty_like(image)
    tint[:] = look.hair
    tint *= shade[..., None]
    mix(image, tint, 0.94 * cover)


def _paint_insides(image: Image, place: Image, chart: NDArray[np.int64], landmarks: NDArray[np.float64]) -> None:
    inside = chart == CAVITY
    deep = fade(place[..., 2], landmarks[54, 2] - 0.002, landmarks[54, 2] + 0.025)
    flesh = np.empty_like(image)
    flesh[:] = _MOUTH
    mix(flesh, (0.10, 0.025, 0.03), deep)
    image[inside] = flesh[inside]
    image[chart == SOCKET] = (0.60, 0.34, 0.31)
    nostril = np.linalg.norm(
        _folded(place) - (landmarks[34] + [0.0, -0.0045, 0.004]).astype(np.float32),
        axis=-1,
    )
    mix(image, (0.16, 0.08, 0.07), 0.75 * fade(nostril, 0.0055, 0.0015))
