"""The frame rate of an animation is read from its file, and a damaged file has none."""

import base64
import json
import struct

import numpy as np
import pytest

from facemime.core.heads.character_files import (
    MorphBind,
    duration_of_gltf,
    expressions_of,
    gltf_of,
    rate_of_file,
    rate_of_times,
)


def gltf(times, *, embedded=False):
    """A glTF document with an animation at these times, and its binary data."""
    data = np.asarray(times, "<f4").tobytes()
    buffer = {"byteLength": len(data)}
    if embedded:
        buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    document = {
        "animations": [{"samplers": [{"input": 0, "output": 0}, {"input": 0, "output": 0}]}],
        "accessors": [{"bufferView": 0, "count": len(times)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [buffer],
    }
    return document, data


def glb(document, data):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 30 / 1.001, 30 * 1.001, 50.0, 60.0, 120.0])
@pytest.mark.parametrize("suffix", [".glb", ".vrm", ".gltf"])
def test_the_rate_of_gltf_is_that_on_whose_frames_its_keyframes_lie(tmp_path, rate, suffix):
    times = np.array([0, 1, 7, 11, 1203, 1204]) / rate
    document, data = gltf(times, embedded=suffix == ".gltf")
    path = tmp_path / f"animation{suffix}"
    path.write_bytes(json.dumps(document).encode() if suffix == ".gltf" else glb(document, data))
    assert rate_of_file(path) == pytest.approx(rate, abs=1e-9)
    assert duration_of_gltf(path) == pytest.approx(1204 / rate)


def test_a_rate_that_fits_no_frames_is_dense_enough():
    rng = np.random.default_rng(0)
    assert rate_of_times(np.cumsum(rng.uniform(1 / 70, 1 / 30, 50))) >= 60.0
    assert rate_of_times(np.array([0.5])) is None and rate_of_times(np.array([np.nan, 0.0])) is None


def test_a_buffer_in_another_file_is_read_from_the_same_folder_only(tmp_path):
    document, data = gltf(np.arange(10) / 60.0)
    (tmp_path / "inner").mkdir()
    for folder, uri, expected in ((tmp_path, "a.bin", 60.0), (tmp_path / "inner", "../a.bin", None)):
        (tmp_path / "a.bin").write_bytes(data)
        document["buffers"][0]["uri"] = uri
        (folder / "a.gltf").write_text(json.dumps(document))
        assert rate_of_file(folder / "a.gltf") == expected


def alembic(samplings):
    """An archive with nothing but these time samplings: pairs of seconds per cycle, and samples in one."""
    table = b"".join(struct.pack("<IdI", 1, cycle, count) + bytes(8 * count) for cycle, count in samplings)
    root = struct.pack("<QQQQQQ", 6, 0, 0, 0, 0, (1 << 63) | 64) + struct.pack("<Q", 0)
    archive = b"Ogawa\xff\x00\x01" + struct.pack("<Q", 16) + root
    archive = archive.ljust(72, b"\0")
    return archive[:64].ljust(64, b"\0") + struct.pack("<Q", len(table)) + table


@pytest.mark.parametrize(
    ("samplings", "rate"), [([(1.0, 1), (1 / 60, 1)], 60.0), ([(1 / 24, 2)], 48.0), ([(1.0, 1)], None)]
)
def test_the_rate_of_alembic_is_that_of_its_densest_samples(tmp_path, samplings, rate):
    (tmp_path / "a.abc").write_bytes(alembic(samplings))
    assert rate_of_file(tmp_path / "a.abc") == (None if rate is None else pytest.approx(rate))


def test_the_rate_of_usd_is_stated_at_its_start(tmp_path):
    (tmp_path / "a.usda").write_text('#usda 1.0\n(\n    doc = "x"\n    timeCodesPerSecond = 50\n)\n')
    assert rate_of_file(tmp_path / "a.usda") == 50.0


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".abc", ".usda", ".obj"])
def test_damaged_files_have_no_rate(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    whole = {".glb": glb(*gltf(np.arange(9) / 60.0)), ".abc": alembic([(1 / 60, 1)])}.get(suffix, b"")
    rng = np.random.default_rng(1)
    assert rate_of_file(path) is None
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        rate_of_file(path)
    for _ in range(300):
        damaged = bytearray(whole or b"{}")
        for place in rng.integers(0, len(damaged), 3):
            damaged[place] = rng.integers(0, 256)
        path.write_bytes(bytes(damaged))
        assert rate_of_file(path) is None or 1.0 <= rate_of_file(path) <= 240.0


def test_expressions_of_both_versions_of_vrm_have_the_names_of_the_key_mappings(tmp_path):
    first = {
        "extensions": {
            "VRM": {
                "blendShapeMaster": {
                    "blendShapeGroups": [
                        {"presetName": "a", "name": "x", "binds": [{"mesh": 2, "index": 3, "weight": 50}]},
                        {"presetName": "blink_l", "binds": [{"mesh": 2, "index": 4, "weight": 100}]},
                        {"presetName": "unknown", "name": "Tongue", "binds": [{"mesh": 1, "index": 0}]},
                        {"presetName": "neutral", "binds": []},
                    ]
                }
            }
        }
    }
    bind = {"node": 1, "index": 5, "weight": 0.75}
    second = {
        "nodes": [{}, {"mesh": 7}],
        "extensions": {"VRMC_vrm": {"expressions": {"preset": {"aa": {"morphTargetBinds": [bind]}, "neutral": {}}}}},
    }
    assert expressions_of(first) == {
        "A": [MorphBind(2, 3, 0.5)],
        "Blink_L": [MorphBind(2, 4, 1.0)],
        "Tongue": [MorphBind(1, 0, 1.0)],
    }
    assert expressions_of(second) == {"aa": [MorphBind(7, 5, 0.75)]} and expressions_of({}) == {}
    with pytest.raises(ValueError, match="node"):
        expressions_of({**second, "nodes": []})
    (tmp_path / "a.vrm").write_bytes(glb(first, b""))
    assert expressions_of(gltf_of(tmp_path / "a.vrm")[0]) == expressions_of(first)
