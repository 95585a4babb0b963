"""Appearance of a head where Blender does not draw it: faces, colours, images, and the parts attached to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ModelError
from ..files.assets import ASSETS
from ..files.reading import read_bytes
from ..numeric.arrays import FloatArray, IntArray
from .built_in import MOUTH_COLOUR, MOUTH_ROUGHNESS, HeadPart, load_head

_MAX_IMAGE = 32_000_000
_TONGUE = "tongueOut"
_FOLLOWS = {"teeth_lower": "jaw", "tongue": "jaw", "teeth_upper": "head", "hair": "head"}
_FINISH = {"skin": 0.46, "eye": 0.06, "teeth": 0.18, "tongue": 0.3, "hair": 0.7}
"""Roughness of the built-in head's surfaces."""


@dataclass(frozen=True, eq=False)
class Material:
    """A surface material.

    Attributes
    ----------
    colour : (float, float, float)
        RGB, linear, 0 to 1.
    roughness : float
        From 0 to 1.
    image : bytes
        A PNG, JPEG or WebP file that replaces the colour; empty for none.
    alpha : bool
        Whether the image is transparent where its alpha says so.
    """

    colour: tuple[float, float, float] = (0.69, 0.45, 0.35)
    roughness: float = 0.5
    image: bytes = b""
    alpha: bool = False


@dataclass(frozen=True, eq=False)
class Patch:
    """Faces of one material.

    Attributes
    ----------
    faces : (F, K) int
        Vertices of each face, padded with -1.
    uv : (F, K, 2) float32 or None
        Texture coordinates of the corners, v up.
    """

    surface: Material
    faces: IntArray
    uv: NDArray[np.float32] | None = None

    def triangles(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Divide the faces into T triangles of the same winding: vertices (3 T,), and uv (3 T, 2), 0 if unknown."""
        faces = np.asarray(self.faces)
        uv = np.zeros((*faces.shape, 2)) if self.uv is None else np.asarray(self.uv)
        rows, places = [np.empty(0, dtype=np.int64)], [np.empty((0, 2))]
        for corner in range(2, faces.shape[1]):
            there = faces[:, corner] >= 0
            fan = [0, corner - 1, corner]
            rows.append(faces[there][:, fan].ravel().astype(np.int64))
            places.append(uv[there][:, fan].reshape(-1, 2).astype(np.float64))
        return np.concatenate(rows), np.concatenate(places)


@dataclass(frozen=True, eq=False)
class AttachedPart:
    """A rigid part that is attached to the head, beside the vertices of the rig.

    Attributes
    ----------
    follows : {"head", "jaw", "eye_right", "eye_left"}
        What the part moves with.
    vertices : (N, 3) float32
        Head frame, unit of the mesh.
    pivot : (3,) float
        Centre of rotation, in the same frame.
    patches : tuple of Patch
        Faces of the part, as indices into `vertices`.
    out : (N, 3) float32 or None
        Displacements of a tongue that is out in full; None for other parts.
    """

    follows: str
    vertices: NDArray[np.float32]
    pivot: NDArray[np.float32]
    patches: tuple[Patch, ...]
    out: NDArray[np.float32] | None = None

    def posed(self, jaw: FloatArray, gaze: FloatArray, tongue: float) -> NDArray[np.float32]:
        """Return the vertices (N, 3) of the part in the head frame, with the tongue out by a share from 0 to 1.

        `jaw` (3, 3) is the rotation of the jaw, `gaze` (2, 3, 3) those of the right and the left eye.
        """
        turn = {"jaw": jaw, "eye_right": gaze[0], "eye_left": gaze[1]}.get(self.follows)
        rest = self.vertices if self.out is None else self.vertices + np.float32(tongue) * self.out
        if turn is None:
            return rest
        return np.asarray(self.pivot + (rest - self.pivot) @ turn.T, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Appearance:
    """The surfaces of a head and of its attached parts; the faces of its own `patches` index `HeadRig.all_vertices`."""

    name: str
    patches: tuple[Patch, ...]
    parts: tuple[AttachedPart, ...] = ()

    def all_patches(self, count: int) -> list[Patch]:
        """Return all patches, their faces indexing the `count` vertices of the rig followed by those of each part."""
        patches = list(self.patches)
        for part in self.parts:
            patches += [Patch(p.surface, np.where(p.faces >= 0, p.faces + count, -1), p.uv) for p in part.patches]
            count += len(part.vertices)
        return patches


def built_in_appearance(name: str = "Facemime Head") -> Appearance:
    """Return the appearance of the built-in head and its parts; ModelError if an image is missing.

    The lashes are patches of `built_in_head(lashes=True)`.
    """
    head = load_head()
    surfaces: dict[str, Material] = {}

    def surface(kind: str) -> Material:
        return surfaces.setdefault(kind, Material(roughness=_FINISH[kind], image=_image(kind)))

    tongue = head.unit_names.index(_TONGUE)
    parts = tuple(_attached(part, surface, tongue) for part in head.parts if part.name != "lashes")
    lashes = head.part("lashes")
    on_skin = np.where(lashes.faces < 0, -1, lashes.faces + len(head.vertices))
    deep = head.deep_in_mouth
    patches = (
        Patch(surface("skin"), head.faces[~deep], head.uv[~deep]),
        Patch(Material(MOUTH_COLOUR, MOUTH_ROUGHNESS), head.faces[deep], head.uv[deep]),
        Patch(surface("hair"), on_skin, lashes.uv),
    )
    return Appearance(name, patches, parts)


def _attached(part: HeadPart, surface: Callable[[str], Material], tongue: int) -> AttachedPart:
    kind = part.name.split("_")[0]
    out = part.units[tongue] if part.name == "tongue" else None
    patch = Patch(surface(kind), part.faces, part.uv)
    return AttachedPart(_FOLLOWS.get(part.name, part.name), part.vertices, part.pivot, (patch,), out)


def _image(kind: str) -> bytes:
    path = ASSETS / "head" / f"{kind}.jpg"
    try:
        return read_bytes(path, _MAX_IMAGE)
    except (OSError, ValueError) as error:
        raise ModelError(
            "The image {path} cannot be read ({error}). Reinstall Facemime.", path=path, error=error
        ) from error
