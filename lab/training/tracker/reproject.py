"""Re-projection: the ICT head is fitted to a photo, which becomes its skin, and is seen acting from elsewhere.

The mesh is bent until its landmark vertices lie at the photo's labels, so that a label moves with the skin that it
marks, and the landmarks of the new image are known exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.mesh.triangles import rasterise
from facemime.core.tracking.pdm import PointDistributionModel

from .heads import EYEBALLS, FACE, IctHead
from .organs import Eyes, tongue_out

_LIDS = {"R": ((37, 41), (38, 40)), "L": ((43, 47), (44, 46))}
_HIDDEN = ("M_EyeBlend", "M_EyeLashes", "M_EyeOcclusion", "M_LacrimalFluid")
_SOCKETS = slice(11248, 14062)


@dataclass(frozen=True)
class SkinnedHead:
    """A person's head, ready to be rendered.

    Attributes
    ----------
    neutral : (V, 3) float32
        Head frame, outer-eye distances; without the photo's own expression as far as could be determined.
    uv : (V, 2) float32
        Where each vertex lies in the photo, pixels.
    skin, eyes : (H, W) uint8
        The photo, and the photo with everything but the open eyes replaced by sclera.
    own_expression : (E,) float32
        The photo's expression.
    blink : dict of str to float
        Coefficient of `eyeBlink` at which each eye of this person is shut.
    """

    neutral: np.ndarray
    uv: np.ndarray
    skin: np.ndarray
    eyes: np.ndarray
    own_expression: np.ndarray
    blink: dict[str, float]


def _fit_coefficients(
    head: IctHead, model: PointDistributionModel, landmarks: np.ndarray, acting: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit pose (6,), identity (100,) and expression (E,) to landmarks (66, 2), by ridge regression."""
    pose = model.fit(landmarks, noise=0.015).pose
    rotation = euler_to_matrix(*pose[1:4])
    points = head.landmarks
    identity = head.identity[:, points].reshape(-1, 66, 3)
    expression = head.expression[:, points].reshape(-1, 66, 3)
    modes = np.concatenate([identity, expression]) @ rotation[:2].T
    columns = np.concatenate(
        [
            modes.reshape(len(modes), -1).T,
            np.tile(np.eye(2), (66, 1)),
            (head.neutral[points] @ rotation[:2].T).reshape(-1, 1),
        ],
        axis=1,
    )
    deviation = np.concatenate([np.ones(100), np.full(len(expression), 0.35 if acting else 1e-3), [10.0, 10.0, 10.0]])
    target = (landmarks - pose[4:6]) / pose[0]
    ridge = (0.015 / deviation) ** 2
    right = columns.T @ (target.reshape(-1) - columns[:, -1])
    solution = np.linalg.solve(columns.T @ columns + np.diag(ridge), right)
    grown = 1.0 + solution[-1]
    fitted = np.array([pose[0] * grown, *pose[1:4], *(pose[4:6] + pose[0] * solution[-3:-1])])
    return fitted, solution[:100] / grown, np.clip(solution[100:-3] / grown, -0.2, 1.0)


def _bend(vertices: np.ndarray, centres: np.ndarray, shift: np.ndarray, anchors: np.ndarray) -> np.ndarray:
    """Smooth displacement (V, 3) that is `shift` (66, 3) at the centres and 0 at the anchors: linear radial basis."""
    places = np.concatenate([centres, anchors])
    values = np.concatenate([shift, np.zeros_like(anchors)])
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    weights = np.linalg.solve(distance - 2e-3 * np.eye(len(places)), values)
    out = np.empty_like(vertices)
    for start in range(0, len(vertices), 4000):
        part = vertices[start : start + 4000]
        out[start : start + 4000] = np.linalg.norm(part[:, None] - places[None], axis=2) @ weights
    return out


def _sclera_photo(photo: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Return the photo with everything but its open eyes painted in the eye's own white."""
    out = photo.copy()
    for eye in (EYE_RIGHT, EYE_LEFT):
        corners = landmarks[eye]
        mask = np.zeros_like(photo)
        cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 255)
        inside = photo[mask > 0]
        white = float(np.percentile(inside, 75)) if inside.size else 128.0
        size = np.ptp(corners[:, 0])
        x, y = corners.mean(0).astype(int)
        reach = max(int(size), 2)
        window = np.s_[max(y - reach, 0) : y + reach, max(x - reach, 0) : x + reach]
        part = out[window]
        part[mask[window] == 0] = white
    return out


def shut_weights(head: IctHead, landmarks: np.ndarray, units: np.ndarray) -> dict[str, float]:
    """Coefficient of `eyeBlink` at which each eye is shut, for landmarks (66, 3) and their expressions (E, 66, 3)."""
    blink = {}
    for side, pairs in _LIDS.items():
        delta = units[head.index(f"eyeBlink_{side}")]
        upper, lower = ([p[i] for p in pairs] for i in (0, 1))
        opening = (landmarks[lower] - landmarks[upper])[:, 1].mean()
        closing = (delta[upper] - delta[lower])[:, 1].mean()
        blink[side] = float(np.clip(opening / closing, 0.4, 1.8))
    return blink


def skin_head(
    head: IctHead, model: PointDistributionModel, photo: np.ndarray, landmarks: np.ndarray, acting: bool
) -> SkinnedHead:
    """Fit the head to a grey photo (H, W) with landmarks (66, 2); `acting` if the face may not be neutral."""
    pose, identity, expression = _fit_coefficients(head, model, landmarks, acting)
    rotation = euler_to_matrix(*pose[1:4])
    own = np.tensordot(expression, head.expression, 1)
    vertices = head.neutral + np.tensordot(identity, head.identity, 1) + own
    projected = pose[0] * vertices[head.landmarks] @ rotation[:2].T + pose[4:6]
    shift = np.zeros((66, 3))
    shift[:, :2] = (landmarks - projected) / pose[0]
    anchors = vertices[9409:11248:60]
    vertices = vertices + _bend(vertices, vertices[head.landmarks], shift @ rotation, anchors[anchors[:, 2] > 1.0])
    uv = pose[0] * vertices @ rotation[:2].T + pose[4:6]
    neutral = vertices - own
    blink = shut_weights(head, neutral[head.landmarks], head.expression[:, head.landmarks])
    return SkinnedHead(
        neutral.astype(np.float32),
        uv.astype(np.float32),
        photo,
        _sclera_photo(photo, landmarks),
        expression.astype(np.float32),
        blink,
    )


@dataclass(frozen=True)
class Light:
    """Ambient and directional light; `direction` (3,) points from the face to the lamp, and -z is frontal."""

    ambient: float
    strength: float
    direction: np.ndarray


WINDOW_LIGHT = Light(0.7, 0.4, np.array([0.4, -0.3, -0.866]))
"""As from a window beside the camera."""


@dataclass(frozen=True)
class Scene:
    """What a head is drawn with, besides its shape and pose.

    Attributes
    ----------
    light : Light
    perspective : float
        Strength k of a magnification 1 / (1 + k z).
    gaze : (float, float)
        Shift of the texture of the eyes, eye distances.
    tongue : (float, float)
        Range of the brightness of tongue and gums relative to the skin.
    tongue_out : float
        How far the tongue is out, 0 to 1; 0 draws none before the teeth.
    eyes : Eyes, optional
        Eyes that are painted; by default they are those of the photo.
    """

    light: Light
    perspective: float = 0.0
    gaze: tuple[float, float] = (0.0, 0.0)
    tongue: tuple[float, float] = (0.35, 0.75)
    tongue_out: float = 0.0
    eyes: Eyes | None = None


@dataclass(frozen=True)
class Rendering:
    """A new image of a known face: grey (S, S) uint8, the area that the face covers, landmarks and their visibility."""

    image: np.ndarray
    covered: np.ndarray
    landmarks: np.ndarray
    visible: np.ndarray


@dataclass(frozen=True)
class _Seen:
    """The nearest surface in each covered pixel, (F,) each: its place, and the part of the head that it belongs to.

    `place` (F, 3) is in the head frame.
    """

    pixel: np.ndarray
    size: int
    vertex: np.ndarray
    material: np.ndarray
    uv: np.ndarray
    depth: np.ndarray
    place: np.ndarray


def _vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    faces = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(triangles.ravel(), np.repeat(faces[:, k], 3), minlength=len(vertices)) for k in range(3)],
        axis=1,
    )
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def _plain_colours(
    head: IctHead, skin_level: float, tongue: tuple[float, float], rng: np.random.Generator
) -> np.ndarray:
    """Grey of materials that no photo shows, (materials,): teeth, gums and tongue; NaN where the photo is used."""
    colour = np.full(len(head.materials), np.nan, np.float32)
    colour[head.materials.index("M_Teeth")] = np.clip(skin_level * rng.uniform(0.8, 2.0), 50, 250)
    colour[head.materials.index("M_GumsTongue")] = skin_level * rng.uniform(*tongue)
    return colour


def _facing_triangles(
    head: IctHead, screen: np.ndarray, triangles: np.ndarray, material: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that are drawn and face the viewer (counter-clockwise with y down), and their material."""
    hidden = [head.materials.index(m) for m in _HIDDEN]
    drawn = ~np.isin(material, hidden)
    a, b, c = (screen[triangles[:, i]] for i in range(3))
    drawn &= np.cross(b - a, c - a) < 0
    return triangles[drawn], material[drawn]


def _grey_of_surfaces(
    head: IctHead, skinned: SkinnedHead, seen: _Seen, scene: Scene, rim: float, rng: np.random.Generator
) -> np.ndarray:
    """Unlit grey of every fragment, (F,): photo, eyes, or the plain colours of the mouth, darker behind `rim`."""
    grey = _look_up(skinned.skin, seen.uv, seen.pixel, seen.size)
    sides = [
        [i for i, m in enumerate(head.materials) if m in (f"M_Sclera{s}", f"M_Iris{s}")] for s in ("Right", "Left")
    ]
    level = float(np.median(grey[seen.material == head.materials.index("M_Face")]))
    if scene.eyes is None:
        shift = np.float32(np.array(scene.gaze) * np.ptp(skinned.uv[FACE, 0]) / 2.0)
        moved = _look_up(skinned.eyes, seen.uv - shift, seen.pixel, seen.size)
        grey = np.where(np.isin(seen.material, np.concatenate(sides)), moved, grey)
    else:
        for side, materials in enumerate(sides):
            shown = np.isin(seen.material, materials)
            grey[shown] = scene.eyes.paint(side, seen.place[shown], skinned.neutral[EYEBALLS[side]], level)
    plain = _plain_colours(head, level, scene.tongue, rng)[seen.material]
    socket = (seen.vertex >= _SOCKETS.start) & (seen.vertex < _SOCKETS.stop)
    plain = np.where(socket, level * rng.uniform(0.08, 0.4), plain)
    steepness = 3.5 if scene.tongue[1] <= 1.0 else 1.5  # a tongue that is seen well lies in the light
    falloff = np.exp(-rng.uniform(0.5, steepness) * np.maximum(seen.depth - rim, 0.0))
    return np.where(np.isnan(plain), grey, plain * falloff)


def render(
    head: IctHead,
    skinned: SkinnedHead,
    expression: np.ndarray,
    pose: np.ndarray,
    size: int,
    scene: Scene,
    rng: np.random.Generator,
) -> Rendering:
    """Draw the head with expression (E,) and pose (6,) into an image of size x size pixels."""
    vertices = skinned.neutral + np.tensordot(expression, head.expression, 1)
    every, materials, uv_of = head.triangles, head.material, skinned.uv
    if scene.tongue_out > 0.0:
        tongue = tongue_out(vertices[head.landmarks], scene.tongue_out, rng)
        every = np.concatenate([every, len(vertices) + tongue.triangles])
        gums = head.materials.index("M_GumsTongue")
        materials = np.concatenate([materials, np.full(len(tongue.triangles), gums, materials.dtype)])
        vertices = np.concatenate([vertices, tongue.vertices])
        uv_of = np.concatenate([uv_of, np.zeros((len(tongue.vertices), 2), np.float32)])
    turned = vertices @ euler_to_matrix(*pose[1:4]).T
    screen = pose[0] * turned[:, :2] / (1.0 + scene.perspective * turned[:, 2:]) + pose[4:6]
    triangles, material = _facing_triangles(head, screen, every, materials)
    drawn = rasterise(screen, turned[:, 2], triangles, size)
    owner, weights = triangles[drawn.triangle], drawn.barycentric
    light = scene.light
    lit = light.ambient + light.strength * np.maximum(_vertex_normals(turned, every) @ light.direction, 0.0)
    uv, place = (np.einsum("fk,fkd->fd", weights, of[owner]).astype(np.float32) for of in (uv_of, vertices))
    depth = drawn.depth.ravel()[drawn.pixel]
    seen = _Seen(drawn.pixel, size, owner[:, 0], material[drawn.triangle], uv, depth, place)
    # Light hardly reaches the back of the mouth; the depth of the lips is its rim.
    grey = _grey_of_surfaces(head, skinned, seen, scene, turned[head.landmarks[60:], 2].min(), rng)
    image = np.zeros(size * size, np.float32)
    image[drawn.pixel] = grey * (weights * lit[owner]).sum(1)
    landmarks = screen[head.landmarks]
    return Rendering(
        np.clip(image, 0, 255).astype(np.uint8).reshape(size, size),
        np.isfinite(drawn.depth),
        landmarks,
        _visible(landmarks, turned[head.landmarks, 2], drawn.depth),
    )


def _look_up(photo: np.ndarray, uv: np.ndarray, pixel: np.ndarray, size: int) -> np.ndarray:
    """Grey of the photo at uv (F, 2), (F,) float32. Sampled as an image, since cv2.remap limits the row length."""
    where = np.zeros((size * size, 2), np.float32)
    where[pixel] = uv
    shown = cv2.remap(photo, where.reshape(size, size, 2), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return shown.ravel()[pixel].astype(np.float32)


def _visible(landmarks: np.ndarray, depth: np.ndarray, buffer: np.ndarray) -> np.ndarray:
    """Whether each landmark is unoccluded, (66,), with some tolerance; landmarks at the very edge count."""
    size = len(buffer)
    column, row = np.clip(np.round(landmarks).astype(int), 1, size - 2).T
    around = np.stack([buffer[row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    return np.max(np.where(np.isfinite(around), around, 1e3), axis=0) > depth - 0.06
