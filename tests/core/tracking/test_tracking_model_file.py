"""The model file: valid models are read, anything else is refused."""

from __future__ import annotations

import hashlib
import io
import struct
from pathlib import Path

import numpy as np
import pytest

from facemime.core.base.errors import ModelError
from facemime.core.tracking.model_file import _HEADER, FORMAT_VERSION, MAGIC, load_model, save_model
from facemime.core.tracking.tracker import DEFAULT_MODEL, FaceTracker


def changed(tmp_path: Path, content: bytes) -> Path:
    path = tmp_path / "changed.tracker"
    path.write_bytes(content)
    return path


def test_the_shipped_model_loads_and_is_below_eight_megabytes() -> None:
    model = load_model(DEFAULT_MODEL)
    assert DEFAULT_MODEL.stat().st_size < 8_000_000
    assert model.pdm.mean_shape.shape == (66, 3)
    assert len(model.model_id) == 12
    assert FaceTracker.load().model_id == model.model_id


def test_a_model_survives_saving_and_loading(tmp_path: Path) -> None:
    model = load_model(DEFAULT_MODEL)
    path = tmp_path / "again.tracker"
    name = save_model(model, path)
    again = load_model(path)
    assert again.model_id == name
    np.testing.assert_allclose(again.pdm.basis, model.pdm.basis)
    np.testing.assert_allclose(again.check.weights, model.check.weights)
    assert again.face.network.onnx == model.face.network.onnx
    assert again.detector.network.onnx == model.detector.network.onnx
    for a, b in zip(again.parts, model.parts, strict=True):
        assert (a.scale, a.paired, a.network.onnx) == (b.scale, b.paired, b.network.onnx)
        np.testing.assert_array_equal(a.landmarks, b.landmarks)
    assert not list(tmp_path.glob("*.part"))


def test_a_missing_file_is_a_model_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        FaceTracker.load(tmp_path / "none.tracker")


@pytest.mark.parametrize("content", [b"", b"GIF89a" + bytes(200), b"\x00" * 50])
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(ModelError, match="not a Facemime tracker model"):
        load_model(changed(tmp_path, content))


@pytest.mark.parametrize("kept", [20, 70, 5000])
def test_a_truncated_file_is_refused(tmp_path: Path, kept: int) -> None:
    with pytest.raises(ModelError, match="truncated"):
        load_model(changed(tmp_path, DEFAULT_MODEL.read_bytes()[:kept]))


def test_a_single_changed_byte_is_detected(tmp_path: Path) -> None:
    content = bytearray(DEFAULT_MODEL.read_bytes())
    content[len(content) // 2] ^= 1
    with pytest.raises(ModelError, match="damaged"):
        load_model(changed(tmp_path, bytes(content)))


def test_a_newer_format_is_refused_and_the_message_says_what_to_do(tmp_path: Path) -> None:
    content = bytearray(DEFAULT_MODEL.read_bytes())
    content[len(MAGIC) : len(MAGIC) + 4] = struct.pack("<I", FORMAT_VERSION + 1)
    with pytest.raises(ModelError, match="Update Facemime"):
        load_model(changed(tmp_path, bytes(content)))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("eigenvalues", np.zeros(48, np.float32), "eigenvalues"),
        ("eigenvalues", np.ones(47, np.float32), "eigenvalues has the shape"),
        ("mean_shape", np.zeros((66, 3), np.float32), "outer-eye distances"),
        ("definition", np.full((66, 3), np.nan, np.float32), "definition is not finite"),
        ("visibility", np.full((2, 66), 2.0, np.float32), "visibility"),
        ("box_offset", np.zeros((3, 3), np.float32), "box_offset"),
        ("face_scales", np.zeros(2), "face_scales"),
        ("face_sizes", np.array([96, 50], np.int32), "multiple of 16"),
        ("part_sizes", np.array([[48, 36], [40, 40]], np.int32), "multiple of 8"),
        ("part_1_landmarks", np.full(23, 40, np.int16), "part 1"),
        ("part_0_landmarks", np.full(11, 66, np.int16), "part_0_landmarks is not within"),
        ("part_paired", np.array([1, 0], np.int32), "part_paired has the type"),
        ("action_sizes", np.array([[48, 64], [64, 56]], np.int32), "cannot run a network"),
        ("action_0_actions", np.full(4, 15, np.int16), "action_0_actions is not within"),
        ("action_1_landmarks", np.zeros(0, np.int16), "no landmarks or no actions"),
        ("patch_scale", np.array(0.0), "patch_scale"),
        ("frontal_step", np.full((66, 32), 3e38, np.float32), "frontal_step"),
        ("side_output", np.zeros((66, 31), np.float16), "side_output has the shape"),
        ("face_0_network", np.zeros(100, np.uint8), "cannot read a network"),
        ("detector_network", np.zeros(100, np.uint8), "cannot read a network"),
        ("check_weights", np.zeros(7, np.float32), "check_weights has the shape"),
    ],
)
def test_an_invalid_model_is_refused(tmp_path: Path, name: str, value: np.ndarray, message: str) -> None:
    with np.load(io.BytesIO(DEFAULT_MODEL.read_bytes()[_HEADER.size :])) as file:
        arrays = {key: file[key] for key in file.files} | {name: value}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    payload = stream.getvalue()
    digest = hashlib.sha256(payload).digest()
    path = changed(tmp_path, _HEADER.pack(MAGIC, FORMAT_VERSION, len(payload), digest) + payload)
    with pytest.raises(ModelError, match=message):
        load_model(path)
