"""The tracker model and its file: a magic number, format version and checksum, then a numpy archive without pickles."""

from __future__ import annotations

import hashlib
import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, Message, ModelError, OutputError
from ..face.landmarks import N_LANDMARKS, outer_eye_distance
from ..face.names import N_ACTIONS
from ..files.archives import MAX_BYTES, Archive, read_archive
from ..files.reading import read_bytes
from ..numeric.arrays import FloatArray, IntArray
from .cascade_detector import DETECTORS
from .experts import FACE_STRIDE, PART_STRIDE, FaceExperts, FacePart, PartExperts
from .gaze import EYES, PupilExperts
from .linear_experts import LinearModel
from .network import N_FEATURES, OUTPUTS, STRIDE, FaceCheck, Network, NetworkDetector
from .patch_experts import PATCH, ActionExperts, PatchExperts
from .pdm import PointDistributionModel

MAGIC = b"FACEMIME TRACKER"
FORMAT_VERSION = 6
_VIEWS = ("frontal", "side")
_HEADER = struct.Struct("<16sIQ32s")
_MAX_SIDE = 512
"""Largest sizes of crops and scales of experts, in pixels: four times those in use."""
_MAX_COORDINATE = 100.0
"""Largest coordinate of a position or displacement, in outer-eye distances."""
_MAX_WEIGHT = 1e4
"""Largest weight of a patch expert."""
_MAX_MODES = 512
"""Largest number of modes, as many as a take can hold."""
_MAX_PARTS = 16
"""Largest number of parts."""
_ADVICE = Message("If you chose this file, choose another one; otherwise reinstall Facemime.")


@dataclass(frozen=True)
class TrackerModel:
    """Everything that the tracker has learnt.

    Attributes
    ----------
    face : FaceExperts
        Experts for a start that may be far from the face.
    glance : FaceExperts
        Experts for a face that is being followed.
    parts : tuple of PartExperts
        Experts of an eye with its brow, and of the mouth with the base of the nose.
    actions : tuple of ActionExperts
        Experts for what no landmark shows: an eye with its brow and its side of the nose, and the mouth with the
        cheeks.
    pupils : PupilExperts
        Experts for the pupils.
    patches : (PatchExperts, PatchExperts)
        Frontal view, and view with the nose to the viewer's left, which serves the other side mirrored.
    definition : (66, 3) float64
        Offset from the landmarks on which the experts were trained to those of `pdm`, in the head frame.
    visibility : (2, 66) float64
        Share of faces in which each landmark is visible, in the frontal view and with the nose to the viewer's left.
    box_offset : (D, 3) float64
        For each detector, translation of the pose from the centre of the box (x, y), and scale, in box widths.
    linear : LinearModel, optional
        The user's own shape model, which is then `pdm`, too, and its experts, which fit it alone.
    model_id : str
        First digits of the file's checksum.
    """

    pdm: PointDistributionModel
    face: FaceExperts
    glance: FaceExperts
    parts: tuple[PartExperts, ...]
    actions: tuple[ActionExperts, ...]
    pupils: PupilExperts
    patches: tuple[PatchExperts, PatchExperts]
    definition: FloatArray
    visibility: FloatArray
    box_offset: FloatArray
    check: FaceCheck
    detector: NetworkDetector
    linear: LinearModel | None = None
    model_id: str = "unsaved"


def _pack_faces(model: TrackerModel) -> dict[str, NDArray[np.generic]]:
    experts = (model.face, model.glance)
    arrays: dict[str, NDArray[np.generic]] = {"face_scales": np.array([e.scale for e in experts])}
    arrays["face_sizes"] = np.array([e.size for e in experts], np.int32)
    return arrays | {f"face_{i}_network": _packed(e.network) for i, e in enumerate(experts)}


def _pack_parts(kind: str, parts: Sequence[FacePart]) -> dict[str, NDArray[np.generic]]:
    arrays: dict[str, NDArray[np.generic]] = {f"{kind}_scales": np.array([p.scale for p in parts])}
    arrays[f"{kind}_sizes"] = np.array([p.size for p in parts], np.int32)
    arrays[f"{kind}_paired"] = np.array([p.paired for p in parts])
    for i, part in enumerate(parts):
        arrays[f"{kind}_{i}_landmarks"] = part.landmarks.astype(np.int16)
        if isinstance(part, ActionExperts):
            arrays[f"{kind}_{i}_actions"] = part.actions.astype(np.int16)
        arrays[f"{kind}_{i}_network"] = _packed(part.network)
    return arrays


def _pack_patches(patches: tuple[PatchExperts, PatchExperts]) -> dict[str, NDArray[np.generic]]:
    arrays: dict[str, NDArray[np.generic]] = {"patch_scale": np.array(patches[0].scale)}
    for name, e in zip(_VIEWS, patches, strict=True):
        # Weights are quantised to 8 bits per column; the rounding is below the noise of training.
        step = np.maximum(np.abs(e.hidden).max(axis=1), 1e-12) / 127.0
        arrays[f"{name}_hidden"] = np.round(e.hidden / step[:, None]).astype(np.int8)
        arrays[f"{name}_step"] = step.astype(np.float32)
        arrays[f"{name}_hidden_bias"] = e.hidden_bias.astype(np.float16)
        arrays[f"{name}_output"] = e.output.astype(np.float16)
        arrays[f"{name}_output_bias"] = e.output_bias.astype(np.float16)
    return arrays


def _unpack_patches(name: str, archive: Archive) -> PatchExperts:
    (scale,) = archive.floats("patch_scale", ()).reshape(1).tolist()
    if not 1.0 <= scale <= _MAX_SIDE:
        raise DataError("patch_scale is not within 1 to {max_side}", max_side=_MAX_SIDE)
    step = archive.floats(f"{name}_step", (N_LANDMARKS, None), np.float32)
    units = step.shape[1]
    if float(np.abs(step).max(initial=0.0)) > _MAX_WEIGHT:
        raise DataError("{name}_step is above {max_weight:g}", name=name, max_weight=_MAX_WEIGHT)
    hidden = archive.floats(f"{name}_hidden", (N_LANDMARKS, PATCH * PATCH, units), np.float32) * step[:, None]
    hidden -= hidden.mean(axis=1, keepdims=True)
    bias, output, output_bias = (
        archive.floats(f"{name}_{part}", shape, np.float32)
        for part, shape in (
            ("hidden_bias", (N_LANDMARKS, units)),
            ("output", (N_LANDMARKS, units)),
            ("output_bias", (N_LANDMARKS,)),
        )
    )
    if any(float(np.abs(values).max(initial=0.0)) > _MAX_WEIGHT for values in (hidden, bias, output, output_bias)):
        raise DataError("{name} has a weight above {max_weight:g}", name=name, max_weight=_MAX_WEIGHT)
    return PatchExperts(scale, hidden, bias, output, output_bias)


def _packed(network: Network) -> NDArray[np.uint8]:
    return np.frombuffer(network.onnx, np.uint8)


def save_model(model: TrackerModel, path: Path) -> str:
    """Write a model file, completely or not at all, and return the model's identifier, as in `TrackerModel`.

    Raises OutputError if the file cannot be written.
    """
    arrays: dict[str, NDArray[np.generic]] = {
        "mean_shape": model.pdm.mean_shape.astype(np.float32),
        "basis": model.pdm.basis.astype(np.float32),
        "eigenvalues": model.pdm.eigenvalues.astype(np.float32),
        "definition": model.definition.astype(np.float32),
        "visibility": model.visibility.astype(np.float32),
        "box_offset": model.box_offset.astype(np.float32),
        "check_weights": model.check.weights.astype(np.float32),
        "detector_network": _packed(model.detector.network),
        **_pack_faces(model),
        **_pack_parts("part", model.parts),
        **_pack_parts("action", model.actions),
        **_pack_parts("pupil", [model.pupils]),
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
        raise OutputError(
            "The model cannot be written to {path}: {reason}. Choose another location.",
            path=path,
            reason=error.strerror,
        ) from error
    return digest.hex()[:12]


def load_model(path: Path) -> TrackerModel:
    """Read a model file.

    Raises ModelError if it is missing, not a tracker model, of a different format version, truncated or damaged.
    """
    payload, digest = _checked_payload(path)
    try:
        return _assemble(read_archive(payload), digest.hex()[:12])
    except ValueError as error:
        raise ModelError(
            "The tracker model {path} is damaged ({error}). {advice}", path=path, error=error, advice=_ADVICE
        ) from error


def unreadable(path: Path, error: OSError, advice: Message) -> ModelError:
    """Return the error of a model file that the system does not let us read."""
    return ModelError(
        "The tracker model {path} cannot be read: {reason}. {advice}", path=path, reason=error.strerror, advice=advice
    )


def _checked_payload(path: Path) -> tuple[bytes, bytes]:
    try:
        content = read_bytes(path, MAX_BYTES)
    except ValueError as error:
        raise ModelError(
            "The tracker model {path} is damaged: {error}. {advice}", path=path, error=error, advice=_ADVICE
        ) from error
    except OSError as error:
        raise unreadable(path, error, _ADVICE) from error
    if content[: len(MAGIC)] != MAGIC:
        raise ModelError("{path} is not a Facemime tracker model. {advice}", path=path, advice=_ADVICE)
    if len(content) < _HEADER.size:
        raise ModelError("The tracker model {path} is truncated. {advice}", path=path, advice=_ADVICE)
    _, version, length, digest = _HEADER.unpack_from(content)
    if version != FORMAT_VERSION:
        raise ModelError(
            "The tracker model {path} has format {version}; this Facemime reads {format_version}. "
            "Update Facemime, or use the model that came with it.",
            path=path,
            version=version,
            format_version=FORMAT_VERSION,
        )
    payload = content[_HEADER.size :]
    if len(payload) < length:
        raise ModelError("The tracker model {path} is truncated. {advice}", path=path, advice=_ADVICE)
    if len(payload) > length or hashlib.sha256(payload).digest() != digest:
        raise ModelError("The tracker model {path} is damaged. {advice}", path=path, advice=_ADVICE)
    return payload, digest


def _assemble(archive: Archive, model_id: str) -> TrackerModel:
    face, glance = (_face(i, archive) for i in range(2))
    visibility = archive.floats("visibility", (2, N_LANDMARKS))
    if visibility.min() < 0.0 or visibility.max() > 1.0:
        raise DataError("visibility is not within 0 to 1")
    box_offset = archive.floats("box_offset", (len(DETECTORS), 3))
    if not (box_offset[:, 2] > 0.0).all():
        raise DataError("box_offset has a scale that is not positive")
    return TrackerModel(
        pdm=_pdm(archive),
        face=face,
        glance=glance,
        parts=_parts(archive),
        actions=_actions(archive),
        pupils=_pupils(archive),
        patches=(_unpack_patches(_VIEWS[0], archive), _unpack_patches(_VIEWS[1], archive)),
        definition=_places("definition", archive),
        visibility=visibility,
        box_offset=box_offset,
        check=FaceCheck(archive.floats("check_weights", (N_FEATURES,))),
        detector=_detector(archive),
        model_id=model_id,
    )


def _places(name: str, archive: Archive, *more: int | None) -> FloatArray:
    """Read positions or displacements (66, 3, ...) in the head frame."""
    places = archive.floats(name, (N_LANDMARKS, 3, *more))
    if np.abs(places).max(initial=0.0) > _MAX_COORDINATE:
        raise DataError("{name} is outside any head", name=name)
    return places


def _pdm(archive: Archive) -> PointDistributionModel:
    mean, basis = _places("mean_shape", archive), _places("basis", archive, None)
    eigenvalues = archive.floats("eigenvalues", (basis.shape[2],))
    if not 1 <= len(eigenvalues) <= _MAX_MODES or not (eigenvalues > 0.0).all():
        raise DataError("eigenvalues are not 1 to {max_modes} positive numbers", max_modes=_MAX_MODES)
    if not 0.5 < outer_eye_distance(mean) < 2.0:
        raise DataError("mean_shape is not in outer-eye distances")
    return PointDistributionModel(mean, basis, eigenvalues)


def _scales(name: str, count: int | None, archive: Archive) -> list[float]:
    scales = archive.floats(name, (count,))
    if not ((scales >= 1.0) & (scales <= _MAX_SIDE)).all():
        raise DataError("{name} is not within 1 to {max_side}", name=name, max_side=_MAX_SIDE)
    return [float(scale) for scale in scales]


def _face(place: int, archive: Archive) -> FaceExperts:
    size = int(archive.integers("face_sizes", (2,), 16, _MAX_SIDE)[place])
    network = Network(archive.data(f"face_{place}_network"), "maps", "face")
    if size % 16:
        raise DataError("face_sizes has {size}, which is not a multiple of 16", size=size)
    cells = size // FACE_STRIDE
    network.check((size, size), (1, N_LANDMARKS, cells, cells), (1, 1, cells // 4, cells // 4))
    return FaceExperts(network, _scales("face_scales", 2, archive)[place], size)


def _detector(archive: Archive) -> NetworkDetector:
    network = Network(archive.data("detector_network"), "faces")
    network.check((64, 32), (1, 1 + len(OUTPUTS), 32 // STRIDE, 64 // STRIDE))
    return NetworkDetector(network)


def _parts(archive: Archive) -> tuple[PartExperts, ...]:
    parts = []
    for i, seen in enumerate(_seen_parts("part", archive)):
        landmarks, _, (width, height), _ = seen
        network = Network(archive.data(f"part_{i}_network"), "maps")
        if not 1 <= len(landmarks) == len(set(landmarks.tolist())) or width % 8 or height % 8:
            raise DataError(
                "part {number} has no landmarks, or one twice, or its size is not a multiple of 8", number=i
            )
        network.check((width, height), (1, len(landmarks), height // PART_STRIDE, width // PART_STRIDE))
        parts.append(PartExperts(network, *seen))
    return tuple(parts)


def _actions(archive: Archive) -> tuple[ActionExperts, ...]:
    parts = []
    for i, seen in enumerate(_seen_parts("action", archive)):
        landmarks, _, size, _ = seen
        actions = archive.integers(f"action_{i}_actions", (None,), 0, N_ACTIONS - 1)
        network = Network(archive.data(f"action_{i}_network"), "actions")
        if not len(landmarks) or not len(actions):
            raise DataError("part {number} has no landmarks or no actions", number=i)
        network.check(size, (1, len(actions)))
        parts.append(ActionExperts(network, *seen, actions))
    return tuple(parts)


def _pupils(archive: Archive) -> PupilExperts:
    seen = next(_seen_parts("pupil", archive))
    landmarks, _, size, paired = seen
    network = Network(archive.data("pupil_0_network"), "pupils")
    if not np.array_equal(landmarks, EYES) or paired:
        raise DataError("the experts of the pupils see other landmarks than those of both eyes")
    network.check(size, (1, 4))
    return PupilExperts(network, *seen)


def _seen_parts(kind: str, archive: Archive) -> Iterator[tuple[IntArray, float, tuple[int, int], bool]]:
    """Yield landmarks, scale, size and pairing of each `FacePart` of a kind."""
    scales = _scales(f"{kind}_scales", None, archive)
    if not 1 <= len(scales) <= _MAX_PARTS:
        raise DataError(
            "{kind}_scales has {scales} parts, not 1 to {max_parts}",
            kind=kind,
            scales=len(scales),
            max_parts=_MAX_PARTS,
        )
    sizes = archive.integers(f"{kind}_sizes", (len(scales), 2), 8, _MAX_SIDE)
    paired = archive.flags(f"{kind}_paired", (len(scales),)).tolist()
    for i, (width, height) in enumerate(sizes.tolist()):
        landmarks = archive.integers(f"{kind}_{i}_landmarks", (None,), 0, N_LANDMARKS - 1)
        yield landmarks, scales[i], (width, height), paired[i]
