"""Assembly of the head, from the pinned source to the files of `assets/head`, byte for byte reproducible."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facemime.core.drive.parts import PartDriver
from facemime.core.face.landmarks import from_ibug
from facemime.core.heads.built_in import FORMAT
from facemime.core.heads.rig import FaceParts, HeadRig
from facemime.core.heads.rig import Part as Kind

from . import complexion, identity
from .anatomy import landmark_vertices
from .complexion import Complexion
from .hair import crop_lift, inside_hairline
from .hairdo import Haircut, crop_locks, cut_hair, knot_locks
from .identity import Identity, identity_offsets
from .lashes import lashes_and_brows
from .layout import layout
from .occlusion import openness, vertex_normals
from .organs import encode, paint_eye, paint_hair, paint_teeth, paint_tongue
from .parts import IRIS_RADIUS, TEETH, build_parts, eye_uv_radius, jaw_hinge
from .refine import swell
from .regions import region_weights
from .ribbons import Shape
from .skin import paint_skin
from .source import BaseMesh, Source
from .surface import Surface, build_surface, ear_share
from .units import mixed, softened

TO_HEAD = np.array([0.1, -0.1, -0.1])
"""From MakeHuman's decimetres (y up, z to the viewer) to the head frame's metres."""

TRAGUS_TO_CENTRE = np.array([0.0, 0.0, 0.016])
"""Distance of the origin behind the middle between landmarks 0 and 16."""

_OVERLAP = 1.06
"""Share of the gap that a blink closes, since the rims are round."""

_BLINK_REACH = 0.045
"""Distance from the eye in metres beyond which a blink moves nothing."""

_SCALP = 0.012
"""Distance inside the hairline in metres from which the skin is finer than hm08."""

_ROUNDED = 2e-5
"""Step in metres to which hair, lashes and brows are rounded."""

_JPEG_QUALITY = 90

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Sculpture:
    """The head before it is painted.

    Attributes
    ----------
    points : (N, 3) vertices of hm08, head frame
    surface : the skin in terms of hm08
    shape : (V, 3) vertices of the skin without hair
    ear : (V,) share of ear
    arrays : what `head.npz` holds
    """

    points: NDArray[np.float64]
    surface: Surface
    shape: NDArray[np.float64]
    ear: NDArray[np.float64]
    arrays: Arrays


@dataclass(frozen=True)
class Person:
    """A person whose head ships: the face, and how it is painted."""

    identity: Identity
    look: Complexion
    haircut: Haircut


MAN = Person(identity.AVATAR, complexion.MAN, Haircut(crop_locks, 0.0047))
WOMAN = Person(identity.WOMAN, complexion.WOMAN, Haircut(knot_locks, 0.0058))


@dataclass(frozen=True)
class Pattern:
    """Common parts of all heads; vertices of the same number are at the same place of every face.

    Attributes
    ----------
    base : BaseMesh
    surface : Surface
        The skin in terms of hm08.
    regions : (3, V) array
        Weights of the regions.
    """

    base: BaseMesh
    surface: Surface
    regions: NDArray[np.float64]


def build_files(source: Source) -> dict[str, bytes]:
    """The files of `assets/head` by name, except for the licence."""
    pattern = cut_pattern(source)
    files, images = {}, {"teeth": paint_teeth(TEETH), "tongue": paint_tongue()}
    for name, suffix, person in (("head", "", MAN), ("woman", "_woman", WOMAN)):
        sculpture = sculpt(source, pattern, person)
        files[f"{name}.npz"] = to_bytes(sculpture.arrays)
        images[f"skin{suffix}"] = _skin(sculpture, person.look)
        images[f"eye{suffix}"] = _eye(sculpture, person.look)
        images[f"hair{suffix}"] = paint_hair(person.look)
    return files | {f"{name}.jpg": encode(image, _JPEG_QUALITY) for name, image in images.items()}


def cut_pattern(source: Source) -> Pattern:
    """Choose the vertices and the regions on the man's head."""
    base = source.base_mesh()
    points = head_points(source, base, MAN.identity)
    scalp = inside_hairline(points, MAN.look.hairline) > _SCALP
    surface = build_surface(base, _on_body(source, base, MAN.identity), scalp)
    landmarks = surface.vertex_of(landmark_vertices(base.mirror))
    return Pattern(base, surface, region_weights(surface, _shape(base, surface, points), landmarks))


def _on_body(source: Source, base: BaseMesh, face: identity.Identity) -> NDArray[np.float64]:
    """Vertices of hm08 with a person's face, (N, 3), in the axes of the head frame, with the origin of hm08."""
    return np.asarray((base.vertices + identity_offsets(source, face)) * TO_HEAD)


def head_points(source: Source, base: BaseMesh, face: identity.Identity) -> NDArray[np.float64]:
    """Vertices of hm08 with a person's face, (N, 3), head frame."""
    points = _on_body(source, base, face)
    tragi = points[landmark_vertices(base.mirror)[[0, 16]]]
    return np.asarray(points - (tragi.mean(axis=0) + TRAGUS_TO_CENTRE))


def _shape(base: BaseMesh, surface: Surface, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vertices of the skin without hair, (V, 3)."""
    rise = swell(surface, points, vertex_normals(points, base.faces))
    return _symmetric(surface.positions(points) + rise, surface.mirror)


def sculpt(source: Source, pattern: Pattern, person: Person) -> Sculpture:
    """A head's shape, landmarks, regions, face units and parts."""
    base, surface = pattern.base, pattern.surface
    points = head_points(source, base, person.identity)
    shape = _shape(base, surface, points)
    native_landmarks = landmark_vertices(base.mirror)
    landmarks = surface.vertex_of(native_landmarks)
    names = source.unit_names()
    own = [fit_blink(name, source.unit(name) * TO_HEAD, points, native_landmarks) for name in names]
    hinge = jaw_hinge(base, points, own[names.index("jawOpen")])
    skin = np.isin(np.arange(len(points)), base.faces[base.groups == "body"])
    units = mixed(names, [softened(name, unit, points, skin) for name, unit in zip(names, own, strict=True)])
    ear = ear_share(surface)
    lift = crop_lift(shape, ear, person.look)[:, None] * vertex_normals(shape, surface.faces)
    vertices = _symmetric(shape + lift, surface.mirror)
    arrays: Arrays = {
        "format": np.array(FORMAT),
        "vertices": vertices.astype(np.float32),
        "faces": surface.faces.astype(np.int16),
        "uv": layout(surface, shape).astype(np.float32),
        "landmarks": landmarks.astype(np.int16),
        "regions": pattern.regions.astype(np.float32),
        "unit_names": np.array(names),
        "units": np.stack([surface.positions(unit) for unit in units]).astype(np.float16),
        "jaw_pivot": hinge.astype(np.float32),
    }
    for part in build_parts(base, points, units, names.index("tongueOut"), hinge, names, own):
        arrays |= _part_arrays(part.name, Shape(part.vertices, part.faces, part.uv), part.pivot)
        arrays[f"{part.name}.units"] = part.units.astype(np.float16)
    hair = cut_hair(person.haircut, vertices, surface.faces, ear, person.look)
    arrays |= _part_arrays("hair", _rounded(hair), np.zeros(3))
    lashes = _rounded(lashes_and_brows(points, shape, landmarks, arrays["eye_left.pivot"].astype(float), person.look))
    arrays |= _part_arrays("lashes", lashes, np.zeros(3))
    arrays["lashes.units"] = _riding(arrays, lashes).astype(np.float16)
    return Sculpture(points, surface, shape, ear, arrays)


def _part_arrays(name: str, shape: Shape, pivot: NDArray[np.float64]) -> Arrays:
    return {
        f"{name}.vertices": shape.vertices.astype(np.float32),
        f"{name}.faces": shape.faces.astype(np.int16),
        f"{name}.uv": shape.uv.astype(np.float32),
        f"{name}.pivot": pivot.astype(np.float32),
    }


def _rounded(shape: Shape) -> Shape:
    """Round a mesh of many small pieces, so that it compresses well."""
    return Shape(_steps(shape.vertices, _ROUNDED), shape.faces, _steps(shape.uv, 1.0 / 512.0))


def _steps(values: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    return np.asarray(np.round(values / size) * size)


def _riding(arrays: Arrays, lashes: Shape) -> NDArray[np.float64]:
    """Motion of the lashes and brows with the skin under each face unit, (U, n, 3)."""
    rest, count = arrays["vertices"], len(lashes.vertices)
    kinds = np.repeat([Kind.SKIN, Kind.ON_SKIN], [len(rest), count]).astype(np.int8)
    faces = np.where(lashes.faces < 0, -1, lashes.faces + len(rest))
    rig = HeadRig(
        rest,
        arrays["landmarks"].astype(np.intp),
        arrays["regions"],
        arrays["jaw_pivot"],
        faces=arrays["faces"].astype(np.intp),
        parts=FaceParts(kinds, lashes.vertices.astype(np.float32), faces),
    )
    alone, skin = rig.skin()
    driver, still = PartDriver(rig, skin, alone), np.stack([np.eye(3)] * 2)
    moved = [driver.pose(rest + unit.astype(np.float32), np.eye(3), still) for unit in arrays["units"]]
    return _steps(np.stack(moved)[:, len(rest) :] - driver.rest[len(rest) :], _ROUNDED)


def fit_blink(
    name: str, unit: NDArray[np.float64], points: NDArray[np.float64], landmarks: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Scale a blink so that the lids of these eyes just meet, as the target was made for wider ones; else return
    `unit`.

    The target also moves a few vertices inside nose and mouth by mistake, which are left alone.
    """
    if not name.startswith("eyeBlink"):
        return unit
    left = name.endswith("Left")
    upper = landmarks[from_ibug([43, 44] if left else [38, 37])]
    lower = landmarks[from_ibug([47, 46] if left else [40, 41])]
    gap = (points[lower] - points[upper])[:, 1].mean()
    closing = (unit[upper] - unit[lower])[:, 1].mean()
    far = np.linalg.norm(points - points[[*upper, *lower]].mean(axis=0), axis=1) > _BLINK_REACH
    return np.where(far[:, None], 0.0, unit * (_OVERLAP * gap / closing))


def to_bytes(arrays: Arrays) -> bytes:
    """Return a compressed npz whose bytes depend only on the arrays, not on time or platform."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            member.compress_type = zipfile.ZIP_DEFLATED
            member.create_system = 3
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array, order="C"), allow_pickle=False)
            archive.writestr(member, content.getvalue())
    return buffer.getvalue()


def _eye(sculpture: Sculpture, look: Complexion) -> NDArray[np.uint8]:
    arrays = sculpture.arrays
    return paint_eye(_iris_share(arrays["eye_left.vertices"] - arrays["eye_left.pivot"]), look)


def _skin(sculpture: Sculpture, look: Complexion) -> NDArray[np.uint8]:
    surface, shape = sculpture.surface, sculpture.shape
    left = np.flatnonzero(shape[:, 0] >= 0.0)
    seen = np.zeros(len(shape))
    seen[left] = openness(shape, surface.faces, left)
    seen[surface.mirror[left]] = seen[left]
    return paint_skin(
        shape,
        surface.faces,
        sculpture.arrays["uv"].astype(np.float64),
        surface.token_chart[surface.tokens[:, 0]],
        np.stack([seen, sculpture.ear], axis=1),
        sculpture.points,
        shape[sculpture.arrays["landmarks"]],
        look,
    )


def _iris_share(eye: NDArray[np.floating]) -> float:
    """Radius of the iris as a share of the eye's texture."""
    radius = float(np.median(np.linalg.norm(eye, axis=1)))
    return float(eye_uv_radius(np.arcsin(np.array([IRIS_RADIUS / radius])))[0])


def _symmetric(vertices: NDArray[np.float64], mirror: NDArray[np.int64]) -> NDArray[np.float64]:
    """Remove the asymmetry that rounding in the source has left."""
    return np.asarray((vertices + vertices[mirror] * [-1.0, 1.0, 1.0]) / 2.0)
