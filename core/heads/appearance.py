"""How a head looks where Blender does not draw it: faces, colours and images, and the parts that are attached to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import IntArray
from ..assets import ASSETS
from ..errors import ModelError
from ..reading import read_bytes
from .built_in import HeadPart, load_head

_MAX_IMAGE = 32_000_000
_TONGUE = "tongueOut"
_FOLLOWS = {"teeth_lower": "jaw", "tongue": "jaw", "teeth_upper": "head"}
_FINISH = {"skin": 0.46, "eye": 0.06, "teeth": 0.18, "tongue": 0.3}
"""Roughness of the built-in head's surfaces."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A material.

    Attributes
    ----------
    colour : (float, float, float)
        RGB, linear, 0 to 1.
    roughness : float
    image : bytes
        A PNG or JPEG that replaces the colour; empty for none.
    """

    colour: tuple[float, float, float] = (0.69, 0.45, 0.35)
    roughness: float = 0.5
    image: bytes = b""


@dataclass(frozen=True, eq=False)
class Patch:
    """Faces of one surface.

    Attributes
    ----------
    surface : Surface
    faces : (F, K) int
        Vertices of each face, padded with -1.
    uv : (F, K, 2) float32 or None
        Texture coordinates of the corners, v up.
    """

    surface: Surface
    faces: IntArray
    uv: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class AttachedPart:
    """A part that moves as a whole, beside the vertices of the rig.

    Attributes
    ----------
    follows : {"head", "jaw", "eye_right", "eye_left"}
    vertices : (N, 3) float32
        Head frame, unit of the mesh.
    pivot : (3,) float
        About which it turns.
    patches : tuple of Patch
        Their faces index `vertices`.
    out : (N, 3) float32 or None
        Displacements of a tongue that is put out.
    """

    follows: str
    vertices: NDArray[np.float32]
    pivot: NDArray[np.float32]
    patches: tuple[Patch, ...]
    out: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class Appearance:
    """A head as it is drawn.

    Attributes
    ----------
    name : str
    patches : tuple of Patch
        Their faces index `HeadRig.all_vertices`.
    parts : tuple of AttachedPart
    """

    name: str
    patches: tuple[Patch, ...]
    parts: tuple[AttachedPart, ...] = ()


def built_in_appearance(name: str = "Facemime Head") -> Appearance:
    """The built-in head with its eyes, teeth and tongue; ModelError if an image is missing."""
    head = load_head()
    surfaces: dict[str, Surface] = {}

    def surface(kind: str) -> Surface:
        return surfaces.setdefault(kind, Surface(roughness=_FINISH[kind], image=_image(kind)))

    tongue = head.unit_names.index(_TONGUE)
    parts = tuple(_attached(part, surface, tongue) for part in head.parts)
    return Appearance(name, (Patch(surface("skin"), head.faces, head.uv),), parts)


def _attached(part: HeadPart, surface: Callable[[str], Surface], tongue: int) -> AttachedPart:
    kind = part.name.split("_")[0]
    out = part.units[tongue] if part.name == "tongue" else None
    patch = Patch(surface(kind), part.faces, part.uv)
    return AttachedPart(_FOLLOWS.get(part.name, part.name), part.vertices, part.pivot, (patch,), out)


def _image(kind: str) -> bytes:
    path = ASSETS / "head" / f"{kind}.jpg"
    try:
        return read_bytes(path, _MAX_IMAGE)
    except (OSError, ValueError) as error:
        raise ModelError(f"The image {path} cannot be read ({error}). Reinstall Facemime.") from error
