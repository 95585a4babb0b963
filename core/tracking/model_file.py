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
from .patch_experts import PatchExperts
from .pdm import PointDistributionModel
from .start import StartModel

MAGIC = b"FACEMIME TRACKER"
FORMAT_VERSION = 1
_HEADER = struct.Struct("<16sIQ32s")
_ADVICE = "Reinstall Facemime, or make the model again with `make model`."


@dataclass(frozen=True)
class TrackerModel:
    """Everything that is learnt.

    Attributes
    ----------
    pdm : PointDistributionModel
    frontal, side : tuple of PatchExperts
        Coarse to fine. The side view's nose points to the viewer's left; the other side mirrors it.
    visibility : (2, 66) float64
        How often each landmark is in sight, frontal and side.
    start : StartModel
    check : FaceCheck
    model_id : str
        First digits of the file's checksum.
    """

    pdm: PointDistributionModel
    frontal: tuple[PatchExperts, ...]
    side: tuple[PatchExperts, ...]
    visibility: FloatArray
    start: StartModel
    check: FaceCheck
    model_id: str = "unsaved"


def _pack_experts(name: str, experts: tuple[PatchExperts, ...]) -> dict[str, NDArray[np.generic]]:
    arrays: dict[str, NDArray[np.generic]] = {f"{name}_scales": np.array([e.scale for e in experts])}
    for i, e in enumerate(experts):
        # A column of weights at a time to 8 bits: the nets' own noise is larger than the rounding.
        step = np.maximum(np.abs(e.hidden).max(axis=1), 1e-12) / 127.0
        arrays[f"{name}_{i}_hidden"] = np.round(e.hidden / step[:, None]).astype(np.int8)
        arrays[f"{name}_{i}_step"] = step.astype(np.float32)
        arrays[f"{name}_{i}_hidden_bias"] = e.hidden_bias.astype(np.float16)
        arrays[f"{name}_{i}_output"] = e.output.astype(np.float16)
        arrays[f"{name}_{i}_output_bias"] = e.output_bias.astype(np.float16)
    return arrays


def _unpack_experts(name: str, arrays: dict[str, NDArray[np.generic]]) -> tuple[PatchExperts, ...]:
    experts = []
    for i, scale in enumerate(arrays[f"{name}_scales"].tolist()):
        hidden = (
            arrays[f"{name}_{i}_hidden"].astype(np.float32) * arrays[f"{name}_{i}_step"].astype(np.float32)[:, None]
        )
        hidden -= hidden.mean(axis=1, keepdims=True)
        rest = (arrays[f"{name}_{i}_{part}"].astype(np.float32) for part in ("hidden_bias", "output", "output_bias"))
        experts.append(PatchExperts(float(scale), hidden, *rest))
    return tuple(experts)


def save_model(model: TrackerModel, path: Path) -> str:
    """Write the model, complete or not at all, and return its identifier."""
    arrays: dict[str, NDArray[np.generic]] = {
        "mean_shape": model.pdm.mean_shape.astype(np.float32),
        "basis": model.pdm.basis.astype(np.float32),
        "eigenvalues": model.pdm.eigenvalues.astype(np.float32),
        "visibility": model.visibility.astype(np.float32),
        "box_offset": model.start.box_offset.astype(np.float32),
        "start_steps": model.start.steps.astype(np.float16),
        "check_weights": model.check.weights.astype(np.float32),
        **_pack_experts("frontal", model.frontal),
        **_pack_experts("side", model.side),
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

    return TrackerModel(
        pdm=PointDistributionModel(real("mean_shape"), real("basis"), real("eigenvalues")),
        frontal=_unpack_experts("frontal", arrays),
        side=_unpack_experts("side", arrays),
        visibility=real("visibility"),
        start=StartModel(real("box_offset"), arrays["start_steps"].astype(np.float32)),
        check=FaceCheck(real("check_weights")),
        model_id=model_id,
    )
