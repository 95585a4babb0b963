"""The model's file: what was written is read, and nothing else is."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from facemime.core.errors import ModelError
from facemime.core.tracking.model_file import FORMAT_VERSION, MAGIC, load_model, save_model
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


def test_a_written_model_is_the_model_that_is_read(tmp_path: Path) -> None:
    model = load_model(DEFAULT_MODEL)
    path = tmp_path / "again.tracker"
    name = save_model(model, path)
    again = load_model(path)
    assert again.model_id == name
    np.testing.assert_allclose(again.pdm.basis, model.pdm.basis)
    np.testing.assert_allclose(again.check.weights, model.check.weights)
    assert again.face.network.onnx == model.face.network.onnx
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
def test_a_file_cut_short_is_refused(tmp_path: Path, kept: int) -> None:
    with pytest.raises(ModelError, match="cut short"):
        load_model(changed(tmp_path, DEFAULT_MODEL.read_bytes()[:kept]))


def test_a_single_changed_byte_is_noticed(tmp_path: Path) -> None:
    content = bytearray(DEFAULT_MODEL.read_bytes())
    content[len(content) // 2] ^= 1
    with pytest.raises(ModelError, match="damaged"):
        load_model(changed(tmp_path, bytes(content)))


def test_a_newer_format_is_refused_and_the_message_says_what_to_do(tmp_path: Path) -> None:
    content = bytearray(DEFAULT_MODEL.read_bytes())
    content[len(MAGIC) : len(MAGIC) + 4] = struct.pack("<I", FORMAT_VERSION + 1)
    with pytest.raises(ModelError, match="Update Facemime"):
        load_model(changed(tmp_path, bytes(content)))
