"""The performer: another identity of the head's family at full resolution, with shirt, hair and brows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.core.face.landmarks import from_ibug
from facemime.core.face.rotation import euler_to_matrix

from ..head import complexion
from ..head.anatomy import LOWER_LID_EDGE, UPPER_LID_EDGE, landmark_vertices
from ..head.build import TO_HEAD, TRAGUS_TO_CENTRE, fit_blink
from ..head.canvas import FrontView, distance_to_line, fade, mix, noise, rasterise
from ..head.cut import CAVITY, FACE, NECK, SOCKET, face_charts
from ..head.hair import brow_strokes, crop, crop_lift
from ..head.identity import Identity, identity_offsets
from ..head.occlusion import vertex_normals
from ..head.parts import Part, build_parts, jaw_hinge
from ..head.source import BaseMesh, Source

PERFORMER = Identity(
    gender=1.0,
    age=0.28,
    muscle=0.5,
    weight=0.60,
    proportions=0.55,
    origins={"caucasian": 0.9, "asian": 0.1},
    details={
        "nose/nose-hump-incr": 0.35,
        "nose/nose-scale-horiz-incr": 0.25,
        "chin/chin-prominent-incr": 0.35,
        "chin/chin-width-incr": 0.3,
        "head/head-square": 0.35,
        "forehead/forehead-temple-incr": 0.3,
        "mouth/mouth-scale-horiz-incr": 0.25,
        "eyes/*-eye-height2-incr": 0.30,
        "eyes/*-eye-trans-in": 0.25,
    },
)

_LOOK = replace(complexion.MAN, hair_lift=0.0042)
"""The man's, with painted hair of its own height, which no geometry covers."""
_CROP_LOW, _CROP_SIZE = np.array([0.31, 0.14]), 0.69
"""The square of the native texture that the head's island fills."""

_TEXTURE = 2048
_HAIR = (0.125, 0.090, 0.070)


@dataclass(frozen=True)
class Skin:
    """A mesh of one material: `faces` (F, 4) into the base mesh's vertices, `uv` (F, 4, 2)."""

    faces: NDArray[np.int64]
    uv: NDArray[np.float64]


@dataclass(frozen=True)
class Actor:
    """Everything that is filmed, in the head frame and metres.

    Attributes
    ----------
    points : (N, 3) vertices of hm08 at rest
    units : name to (N, 3) offsets
    skins : material to faces: head, neck, flesh, shirt
    parts : eyeballs, teeth, tongue; their units are in the order of `units`
    landmarks : (66,) vertices
    follow : (N,) share in 0..1 in which a vertex follows the head rather than the chest
    pivot : (3,) about which the head turns
    texture : (S, S, 3) BGR picture of the head's skin
    """

    points: NDArray[np.float64]
    units: dict[str, NDArray[np.float64]]
    skins: dict[str, Skin]
    parts: tuple[Part, ...]
    landmarks: NDArray[np.int64]
    follow: NDArray[np.float64]
    pivot: NDArray[np.float64]
    texture: NDArray[np.uint8]

    def posed(
        self, weights: dict[str, float], pose: NDArray[np.float64], place: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        """Return vertices of the base mesh and of each part under face units, pose and translation of the head."""
        points = self.points.copy()
        parts = [part.vertices for part in self.parts]
        for row, (name, offsets) in enumerate(self.units.items()):
            if weight := weights.get(name, 0.0):
                points += weight * offsets
                parts = [vertices + weight * part.units[row] for vertices, part in zip(parts, self.parts, strict=True)]
        rotation = euler_to_matrix(*pose)
        turned = (points - self.pivot) @ rotation.T + self.pivot + place
        points += self.follow[:, None] * (turned - points)
        return points, [(vertices - self.pivot) @ rotation.T + self.pivot + place for vertices in parts]


def build_actor(source: Source, skin: Path) -> Actor:
    """Return the performer with the MakeHuman skin texture at `skin`."""
    base = source.base_mesh()
    points = (base.vertices + identity_offsets(source, PERFORMER)) * TO_HEAD
    landmarks = landmark_vertices(base.mirror)
    chart = face_charts(base, points)
    over_cut = -0.628 - points[:, 1] - 0.32 * (points[:, 2] + 0.08)
    over_cut += points[landmarks[8], 1] + 0.669
    centre = points[landmarks[[0, 16]]].mean(axis=0) + TRAGUS_TO_CENTRE
    points = points - centre
    names = source.unit_names()
    units = [fit_blink(name, source.unit(name) * TO_HEAD, points, landmarks) for name in names]
    hinge = jaw_hinge(base, points, units[names.index("jawOpen")])
    parts = build_parts(base, points, units, names.index("tongueOut"), hinge, names, units)
    skins = _skins(base, points, chart)
    ear = _ears(base, chart)
    texture = _texture(points, skins["head"], ear, points[landmarks], skin)
    head_faces = base.faces[chart == FACE]
    lifted = points + crop_lift(points, ear, _LOOK)[:, None] * vertex_normals(points, head_faces)
    shirt = base.groups == "helper-tights"
    rows = np.unique(base.faces[shirt])
    lifted[rows] += 0.004 * vertex_normals(points, base.faces[shirt])[rows]
    return Actor(
        points=lifted,
        units=dict(zip(names, units, strict=True)),
        skins=skins,
        parts=parts,
        landmarks=landmarks,
        follow=fade(over_cut, -0.030, 0.040),
        pivot=np.array([0.0, 0.055, 0.022]),
        texture=texture,
    )


def _skins(base: BaseMesh, points: NDArray[np.float64], chart: NDArray[np.int64]) -> dict[str, Skin]:
    centre = points[base.faces].mean(axis=1)
    near = (centre[:, 1] < 0.36) & (np.abs(centre[:, 0]) < 0.40)
    neckline = centre[:, 1] + 0.75 * (centre[:, 2] + 0.02)
    body = (base.groups == "body") & (chart < 0) | (chart == NECK)
    shirt = (base.groups == "helper-tights") & near & (neckline > 0.152)
    skins = {
        "head": chart == FACE,
        "flesh": (chart == CAVITY) | (chart == SOCKET),
        "neck": body & near & (neckline < 0.172),
        "shirt": shirt,
    }
    uv = base.uv[base.face_uv]
    result = {name: Skin(base.faces[rows], uv[rows]) for name, rows in skins.items()}
    head = result["head"]
    result["head"] = Skin(head.faces, (head.uv - _CROP_LOW) / _CROP_SIZE)
    return result


def _ears(base: BaseMesh, chart: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N,) 1 on the ears, as `surface.ear_share` but for all vertices."""
    uv = base.uv[base.face_uv[chart == FACE]]
    across = np.abs(uv[..., 1] - 0.4842)
    distance = np.hypot((uv[..., 0] - 0.848) / 0.026, (across - 0.1416) / 0.020)
    share = np.zeros(len(base.vertices))
    np.maximum.at(share, base.faces[chart == FACE], np.clip(2.6 - 1.6 * distance, 0.0, 1.0))
    return share


def _texture(
    points: NDArray[np.float64],
    head: Skin,
    ear: NDArray[np.float64],
    landmarks: NDArray[np.float64],
    skin: Path,
) -> NDArray[np.uint8]:
    """Return the head's part of the skin texture, with brows, lashes and cropped hair painted over it."""
    picture = cv2.imread(str(skin)).astype(np.float32)[..., ::-1] / 255.0
    side = len(picture)
    left, top = _CROP_LOW[0] * side, (1.0 - _CROP_LOW[1] - _CROP_SIZE) * side
    scale = _TEXTURE / (_CROP_SIZE * side)
    move = np.array([[scale, 0.0, -left * scale], [0.0, scale, -top * scale]])
    image = cv2.warpAffine(picture, move, (_TEXTURE, _TEXTURE), flags=cv2.INTER_CUBIC)
    texels = rasterise(points, head.faces, head.uv, ear[:, None], _TEXTURE)
    place = texels.place
    folded = np.concatenate([np.abs(place[..., :1]), place[..., 1:]], axis=-1)
    lash = distance_to_line(folded, points[[*UPPER_LID_EDGE]])
    mix(image, (0.08, 0.06, 0.05), 0.95 * fade(lash, 0.0013, 0.0004))
    lash = distance_to_line(folded, points[[*LOWER_LID_EDGE]])
    mix(image, (0.16, 0.10, 0.09), 0.55 * fade(lash, 0.0008, 0.0002))
    view = FrontView((-0.08, -0.07), (0.08, 0.04), 0.00006)
    brow_strokes(view, landmarks[from_ibug(range(22, 27)), :2], _LOOK.brow, np.random.default_rng(21))
    facing = fade(place[..., 2], -0.040, -0.055)
    soft = cv2.GaussianBlur(view.ink, (0, 0), 14.0)
    for ink, strength in ((soft, 0.55), (view.ink, 0.80)):
        view.ink = ink
        mix(image, _HAIR, strength * np.clip(1.2 * view.look_up(place), 0.0, 1.0) * facing)
    cover, shade = crop(place, texels.value[..., 0], _LOOK)
    tint = np.empty_like(image)
    tint[:] = _HAIR
    tint *= (shade * (1.0 + 0.12 * noise(place, 0.012, 5)))[..., None]
    mix(image, tint, 0.93 * cover)
    return np.asarray((np.clip(image[..., ::-1], 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8))
