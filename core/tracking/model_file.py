"""The tracker's model and its file: magic, format version, checksum, then a numpy archive without pickles."""

from __future__ import annotations

import hashlib
import io
import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import ModelError, OutputError
from .check import FaceCheck
from .experts import FaceExperts, PartExperts
from .network import Network
from .patch_experts import PatchExperts
from .pdm import PointDistributionModel

MAGIC = b"FACEMIME TRACKER"
FORMAT_VERSION = 3
_VIEWS = ("frontal", "side")
_HEADER = struct.Struct("<16sIQ32s")
_ADVICE = "Reinstall Facemime, or make the model again with `make model`."


@dataclass(frozen=True)
class TrackerModel:
    """Everything that is learnt.

    Attributes
    ----------
    pdm : PointDistributionModel
    face : FaceExperts
        For a start that may be far off.
    glance : FaceExperts
        For a face that is where it was a frame ago.
    parts : tuple of PartExperts
        The eyes with their brows, and the mouth with the nose's base.
    patches : (PatchExperts, PatchExperts)
        Frontal, and with the nose to the viewer's left, which in a mirror serves the other side.
    definition : (66, 3) float64
        From the places that the experts were taught to the places where `pdm` has the landmarks, head frame.
    visibility : (2, 66) float64
        How often each landmark is in sight, in the frontal view and where the nose points to the viewer's left.
    box_offset : (D, 3) float64
        For each detector: the pose's translation from the box's centre (x, y) and its scale, in box widths.
    check : FaceCheck
    model_id : str
        First digits of the file's checksum.
    """

    pdm: PointDistributionModel
    face: FaceExperts
    glance: FaceExperts
    parts: tuple[PartExperts, ...]
    patches: tuple[PatchExperts, PatchExperts]
    definition: FloatArray
    visibility: FloatArray
    box_offset: FloatArray
    check: FaceCheck
    model_id: str = "unsaved"


def _pack_faces(model: TrackerModel) -> dict[str, NDArray[np.generic]]:
    experts = (model.face, model.glance)
    arrays: dict[str, NDArray[np.generic]] = {"face_scales": np.array([e.scale for e in experts])}
    arrays["face_sizes"] = np.array([e.size for e in experts], np.int32)
    return arrays | {f"face_{i}_network": _packed(e.network) for i, e in enumerate(experts)}


def _pack_parts(parts: tuple[PartExperts, ...]) -> dict[str, NDArray[np.generic]]:
    arrays: dict[str, NDArray[np.generic]] = {"part_scales": np.array([p.scale for p in parts])}
    arrays["part_sizes"] = np.array([p.size for p in parts], np.int32)
    arrays["part_paired"] = np.array([p.paired for p in parts])
    for i, part in enumerate(parts):
        arrays[f"part_{i}_landmarks"] = part.landmarks.astype(np.int16)
        arrays[f"part_{i}_network"] = _packed(part.network)
    return arrays


def _pack_patches(patches: tuple[PatchExperts, PatchExperts]) -> dict[str, NDArray[np.generic]]:
    arrays: dict[str, NDArray[np.generic]] = {"patch_scale": np.array(patches[0].scale)}
    for name, e in zip(_VIEWS, patches, strict=True):
        # A column of weights at a time to 8 bits: the nets' own noise is larger than the rounding.
        step = np.maximum(np.abs(e.hidden).max(axis=1), 1e-12) / 127.0
        arrays[f"{name}_hidden"] = np.round(e.hidden / step[:, None]).astype(np.int8)
        arrays[f"{name}_step"] = step.astype(np.float32)
        arrays[f"{name}_hidden_bias"] = e.hidden_bias.astype(np.float16)
        arrays[f"{name}_output"] = e.output.astype(np.float16)
        arrays[f"{name}_output_bias"] = e.output_bias.astype(np.float16)
    return arrays


def _unpack_patches(name: str, arrays: dict[str, NDArray[np.generic]]) -> PatchExperts:
    hidden = arrays[f"{name}_hidden"].astype(np.float32) * arrays[f"{name}_step"].astype(np.float32)[:, None]
    hidden -= hidden.mean(axis=1, keepdims=True)
    rest = (arrays[f"{name}_{part}"].astype(np.float32) for part in ("hidden_bias", "output", "output_bias"))
    return PatchExperts(float(arrays["patch_scale"].item()), hidden, *rest)


def _packed(network: Network) -> NDArray[np.uint8]:
    return np.frombuffer(network.onnx, np.uint8)


def save_model(model: TrackerModel, path: Path) -> str:
    """Write the model, complete or not at all, and return its identifier."""
    arrays: dict[str, NDArray[np.generic]] = {
        "mean_shape": model.pdm.mean_shape.astype(np.float32),
        "basis": model.pdm.basis.astype(np.float32),
        "eigenvalues": model.pdm.eigenvalues.astype(np.float32),
        "definition": model.definition.astype(np.float32),
        "visibility": model.visibility.astype(np.float32),
        "box_offset": model.box_offset.astype(np.float32),
        "check_weights": model.check.weights.astype(np.float32),
        **_pack_faces(model),
        **_pack_parts(model.parts),
        **_pack_patches(model.patches),
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    payload = buffer.getvalue()
    digest = hashlib.sha256(payload).digest()
    unfinished = path.with_name(path.name + ".part")
    try:
        unfinished.write_bytes(_HEADER.pack(MAGIC, FORMAT_VERSION, len(payload), digest) + payload)
        unfinished.replace(path)
    except OSError as error:
        raise OutputError(f"The model cannot be written to {path}: {error.strerror}. Choose another place.") from error
    return digest.hex()[:12]


def load_model(path: Path) -> TrackerModel:
    """Read a model file.

    Raises
    ------
    ModelError
        Where the file is missing, not a tracker model, of a newer format, cut short or changed.
    """
    payload, digest = _checked_payload(path)
    try:
        with np.load(io.BytesIO(payload), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _assemble(arrays, digest.hex()[:12])
    except (KeyError, ValueError, zipfile.BadZipFile) as error:
        raise ModelError(f"The tracker model {path} lacks a part ({error}). {_ADVICE}") from error


def _checked_payload(path: Path) -> tuple[bytes, bytes]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(f"The tracker model {path} cannot be read: {error.strerror}. {_ADVICE}") from error
    if content[: len(MAGIC)] != MAGIC:
        raise ModelError(f"{path} is not a Facemime tracker model. {_ADVICE}")
    if len(content) < _HEADER.size:
        raise ModelError(f"The tracker model {path} is cut short. {_ADVICE}")
    _, version, length, digest = _HEADER.unpack_from(content)
    if version != FORMAT_VERSION:
        raise ModelError(
            f"The tracker model {path} has format {version}; this Facemime reads {FORMAT_VERSION}. "
            "Update Facemime, or use the model that came with it."
        )
    payload = content[_HEADER.size :]
    if len(payload) < length:
        raise ModelError(f"The tracker model {path} is cut short. {_ADVICE}")
    if len(payload) > length or hashlib.sha256(payload).digest() != digest:
        raise ModelError(f"The tracker model {path} is damaged. {_ADVICE}")
    return payload, digest


def _assemble(arrays: dict[str, NDArray[np.generic]], model_id: str) -> TrackerModel:
    def real(name: str) -> FloatArray:
        return arrays[name].astype(np.float64)

    face, glance = (
        FaceExperts(Network(arrays[f"face_{i}_network"].tobytes(), "maps", "face"), scale, size)
        for i, (scale, size) in enumerate(zip(real("face_scales").tolist(), arrays["face_sizes"].tolist(), strict=True))
    )
    scales, sizes, paired = (arrays[f"part_{name}"].tolist() for name in ("scales", "sizes", "paired"))
    parts = [
        PartExperts(
            Network(arrays[f"part_{i}_network"].tobytes(), "maps"),
            arrays[f"part_{i}_landmarks"].astype(np.intp),
            scales[i],
            (sizes[i][0], sizes[i][1]),
            paired[i],
        )
        for i in range(len(scales))
    ]
    return TrackerModel(
        pdm=PointDistributionModel(real("mean_shape"), real("basis"), real("eigenvalues")),
        face=face,
        glance=glance,
        parts=tuple(parts),
        patches=(_unpack_patches(_VIEWS[0], arrays), _unpack_patches(_VIEWS[1], arrays)),
        definition=real("definition"),
        visibility=real("visibility"),
        box_offset=real("box_offset"),
        check=FaceCheck(real("check_weights")),
        model_id=model_id,
    )
