"""What the page loads once for a head, as the graphics card needs it, and the frames that move it.

The page computes what `HeadDriver` does. The skin is ``rest + W d + sum a_k M_k``, with the displacements `d` of the
landmarks and the amounts `a` of the actions; lids then slide over the eyeballs; eyes and lower teeth turn, the latter
stay behind the skin, and lashes and the like follow it. A head that is driven by shape keys has no `W`, and its `a` are
the values of the keys.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..deform.rbf import RBFDeformer
from ..drive.driver import HeadDriver
from ..errors import FacemimeError, HeadError
from ..face.landmarks import N_LANDMARKS
from ..heads.appearance import Appearance, AttachedPart, Material
from ..heads.rig import neck_of
from ..numeric.arrays import FloatArray, IntArray
from ..puppet.outputs import KeyDriver
from .page import digest

MAGIC = b"FMVM"


STILL, SKIN, EYE_RIGHT, EYE_LEFT, JAW, RIDING, TONGUE, GUMS = range(8)
"""What a vertex of the page follows."""
MAX_AMOUNTS = 512
"""Largest number of shape keys that a page can mix. Four keys need one of the 224 uniforms that any graphics card
has."""
_TURNS = {"eye_right": EYE_RIGHT, "eye_left": EYE_LEFT, "jaw": JAW, "head": STILL}


@dataclass(frozen=True, eq=False)
class ViewerModel:
    """A head for the page.

    Attributes
    ----------
    data : bytes
        Header and arrays, as described in viewer.md.
    images : tuple of bytes
        PNG or JPEG files, to which the header refers by number.
    unit : float
        Outer-eye distance, in the unit of the mesh.
    landmarks : int
        Number of displacements per frame: 66, or 0 for a head that is driven by shape keys.
    amounts : int
        Number of activations and of weights of examples, or of values of keys, per frame.
    """

    data: bytes
    images: tuple[bytes, ...]
    unit: float
    landmarks: int
    amounts: int


def viewer_model(driver: HeadDriver | KeyDriver, appearance: Appearance) -> ViewerModel:
    """Prepare a head for the page; the patches of its appearance index `HeadRig.all_vertices`.

    Raises HeadError if the head is driven in a way that is not linear, or by too many keys.
    """
    head = driver.head if isinstance(driver, KeyDriver) else driver
    rig, unit = head.rig, head.rig.eye_distance
    parts = appearance.parts
    arrays = _skin_of_keys(driver) if isinstance(driver, KeyDriver) else _skin_of(head)
    rest = np.concatenate([head.rest, *(part.vertices for part in parts)]).astype(np.float32)
    kinds, sources = _follows(head, parts, driven_by_keys=isinstance(driver, KeyDriver))
    arrays |= {"rest": rest, "kinds": kinds, "sources": sources}
    riding, glue = (np.empty(0), None) if head.parts is None or driver is not head else head.parts.riding
    if glue is not None and len(riding):
        arrays["riding"], arrays["roots"] = glue.tables()
    if head.parts is not None and driver is head and len(head.parts.gums.rows):
        arrays["gums"] = head.parts.gums.table()
    out = [part.out for part in parts if part.out is not None]
    if head.parts is not None and driver is head:
        out.insert(0, head.parts.tongue[1])
    arrays["tongue"] = np.concatenate([np.empty((0, 3), dtype=np.float32), *out]).astype(np.float32)
    surfaces, drawn = _drawn(appearance, len(head.rest))
    landmarks = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    images = [surface.image for surface in surfaces if surface.image]
    header = {
        "name": appearance.name,
        "unit": unit,
        "neck": neck_of(landmarks).tolist(),
        "face": landmarks.mean(axis=0).tolist(),
        "pivots": _pivots(head, parts),
        "columns": int(arrays["weights"].shape[1]),
        "amounts": int(arrays["modes"].shape[1]),
        "surfaces": [_described(surface, images) for surface in surfaces],
    }
    return ViewerModel(
        pack(header, arrays | drawn),
        tuple(images),
        unit,
        N_LANDMARKS if driver is head else 0,
        int(arrays["modes"].shape[1]),
    )


def pack(header: dict[str, object], arrays: dict[str, NDArray[np.generic]]) -> bytes:
    """Serialise a header, which is extended by the positions of the arrays, and arrays, each aligned to 4 bytes."""
    places, chunks, offset = {}, [], 0
    for name, array in arrays.items():
        little = array.astype(array.dtype.newbyteorder("<"), copy=False)
        data = np.ascontiguousarray(little).tobytes()
        places[name] = [little.dtype.str[1:], offset, int(array.size)]
        chunks += [data, b"\0" * (-len(data) % 4)]
        offset += len(data) + (-len(data) % 4)
    text = json.dumps(header | {"arrays": places}).encode()
    text += b" " * (-len(text) % 4)
    return b"".join((MAGIC, len(text).to_bytes(4, "little"), text, *chunks))


def _skin_of(head: HeadDriver) -> dict[str, NDArray[np.generic]]:
    """Return the deformer as arrays: rest (U, 3), spheres (U, 4), weights (U, 66 and padding), modes (U, K, 4)."""
    if not isinstance(head.deformer, RBFDeformer):
        raise HeadError(
            "A head that is refitted every frame cannot be shown in the viewer. Turn off Refit Every Frame."
        )
    rest = head.deformer.rest
    weights = np.zeros((len(rest), -(-N_LANDMARKS // 4) * 4), dtype=np.float16)
    weights[:, :N_LANDMARKS] = head.deformer.matrix()
    planar, taught = head.options.mode == "planar", head.taught.modes
    actions = 0 if head.modes is None else len(head.modes)
    modes = np.zeros((len(rest), actions + len(taught), 4), dtype=np.float16)
    if head.modes is not None:
        modes[:, :actions, : 2 if planar else 3] = np.moveaxis(head.modes, 0, 1)[..., : 2 if planar else 3]
    modes[:, actions:, :3] = np.moveaxis(taught, 0, 1)
    touching = head.options.contact and not planar
    spheres = head.contact.spheres(len(rest)) if touching else np.zeros((len(rest), 4), dtype=np.float32)
    return {"skin": rest, "spheres": spheres, "weights": weights, "modes": modes}


def _skin_of_keys(driver: KeyDriver) -> dict[str, NDArray[np.generic]]:
    rest, offsets = driver.head.rest, driver.keys.offsets
    if len(offsets) > MAX_AMOUNTS:
        raise HeadError(
            "The head is driven by {offsets} shape keys; the viewer supports at most {max_amounts}. "
            "Use a key mapping with fewer keys.",
            offsets=len(offsets),
            max_amounts=MAX_AMOUNTS,
        )
    modes = np.zeros((len(rest), len(offsets), 4), dtype=np.float16)
    for number, motion in enumerate(offsets.values()):
        modes[:, number, :3] = motion
    return {
        "skin": rest,
        "spheres": np.zeros((len(rest), 4), dtype=np.float32),
        "weights": np.zeros((len(rest), 0), dtype=np.float16),
        "modes": modes,
    }


def _follows(
    head: HeadDriver, parts: tuple[AttachedPart, ...], *, driven_by_keys: bool
) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
    """Return what each vertex follows, and its vertex of the skin, its riding point, or its vertex of the tongue."""
    count = len(head.rest)
    kinds, sources = np.full(count, SKIN, dtype=np.uint8), np.arange(count, dtype=np.uint32)
    if head.parts is not None and not driven_by_keys:
        copies = head.parts.copies
        kinds[copies < 0], sources = STILL, np.maximum(copies, 0).astype(np.uint32)
        for name, rows, _ in head.parts.turning:
            kinds[rows] = _TURNS[name]
        riding, _ = head.parts.riding
        kinds[riding], sources[riding] = RIDING, np.arange(len(riding))
        gums = head.parts.gums.rows
        kinds[gums], sources[gums] = GUMS, np.arange(len(gums))
        own_tongue, _ = head.parts.tongue
        kinds[own_tongue], sources[own_tongue] = TONGUE, np.arange(len(own_tongue))
    own, tongue = [kinds], int((kinds == TONGUE).sum())
    numbers = [sources]
    for part in parts:
        size = len(part.vertices)
        own.append(np.full(size, _TURNS[part.follows] if part.out is None else TONGUE, dtype=np.uint8))
        numbers.append(np.arange(size, dtype=np.uint32) + np.uint32(tongue))
        tongue += size if part.out is not None else 0
    return np.concatenate(own), np.concatenate(numbers)


def _pivots(head: HeadDriver, parts: tuple[AttachedPart, ...]) -> dict[str, list[float]]:
    pivots = {"jaw": np.asarray(head.rig.jaw_pivot, dtype=np.float64).tolist()}
    for name, _, centre in [] if head.parts is None else head.parts.turning:
        pivots[name] = centre.tolist()
    return pivots | {part.follows: np.asarray(part.pivot, np.float64).tolist() for part in parts}


def _drawn(appearance: Appearance, count: int) -> tuple[list[Material], dict[str, NDArray[np.generic]]]:
    """Return the materials, and what the graphics card draws: a corner per pair of vertex and texture coordinate."""
    patches = appearance.all_patches(count)
    surfaces = list(dict.fromkeys(patch.surface for patch in patches))
    rows: list[IntArray] = [np.empty(0, dtype=np.int64)]
    places: list[FloatArray] = [np.empty((0, 2))]
    numbers = [np.empty(0, dtype=np.int64)]
    for patch in patches:
        corners, uv = patch.triangles()
        rows.append(corners)
        places.append(uv)
        numbers.append(np.full(len(corners) // 3, surfaces.index(patch.surface)))
    row, uv = np.concatenate(rows), np.concatenate(places).astype(np.float32)
    keys = np.column_stack([row, np.rint(uv * 16384.0).astype(np.int64)])
    _, kept, corner = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    surface = np.concatenate(numbers)
    order = np.argsort(surface, kind="stable")
    return surfaces, {
        "rows": row[kept].astype(np.uint32),
        "uv": uv[kept],
        "triangles": corner.reshape(-1, 3)[order].astype(np.uint32),
        "sizes": np.bincount(surface, minlength=len(surfaces)).astype(np.uint32),
    }


def _described(surface: Material, images: list[bytes]) -> dict[str, object]:
    number = next((number for number, image in enumerate(images) if image is surface.image), -1)
    return {"colour": list(surface.colour), "roughness": surface.roughness, "image": number, "alpha": surface.alpha}


class Scene:
    """The heads that are shown.

    Attributes
    ----------
    models : tuple of ViewerModel
        What pages load; empty if a head cannot be shown.
    number : int
        Increases with every change.
    path : str
        Folder of the models, which depends on their content alone.
    message : str
        Reason why the heads cannot be shown; otherwise "".
    """

    def __init__(self, appearances: Sequence[Appearance]) -> None:
        self.models: tuple[ViewerModel, ...] = ()
        self.number, self.path, self.message = 0, "", ""
        self._appearances = tuple(appearances)
        self._made_of: list[object] = []

    def update(self, drivers: Sequence[HeadDriver | KeyDriver]) -> bool:
        """Make the models again if the heads or their deformers have changed, and return whether they have."""
        made_of = [part for driver in drivers for part in _made_of(driver)]
        if len(made_of) == len(self._made_of) and all(a is b for a, b in zip(made_of, self._made_of, strict=True)):
            return False
        self._made_of = made_of
        try:
            self.models, self.message = tuple(map(viewer_model, drivers, self._appearances)), ""
        except FacemimeError as error:
            self.models, self.message = (), str(error)
        self.number += 1
        self.path = digest(*[data for model in self.models for data in (model.data, *model.images)])
        return True


def description(number: int, path: str, models: Sequence[ViewerModel]) -> str:
    """Return the description of a scene that pages load first, JSON."""
    return json.dumps({"scene": number & 0xFFFF, "path": path, "images": [len(model.images) for model in models]})


def _made_of(driver: HeadDriver | KeyDriver) -> tuple[object, ...]:
    """Return the objects that a model depends on, compared by identity; a new calibration keeps them."""
    head = driver.head if isinstance(driver, KeyDriver) else driver
    return driver.keys if isinstance(driver, KeyDriver) else None, head.rig, head.deformer
