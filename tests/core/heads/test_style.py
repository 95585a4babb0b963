"""Styles: their file, and what is refused."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from facemime.core.errors import HeadError, OutputError, SourceError
from facemime.core.heads.rig import built_in_head
from facemime.core.heads.style import N_FEATURES, Example, Style, load_style, save_style, style_bytes, style_of
from facemime.core.heads.thumbnail import SIDE, pixels_of, thumbnail


def style() -> Style:
    """Two examples, of a mesh and of keys."""
    rng = np.random.default_rng(1)
    first = Example(
        "Smile",
        "Anna",
        rng.normal(size=N_FEATURES),
        rng.normal(size=(12, 3)).astype(np.float32),
        weight=0.5,
        thumbnail=b"picture",
    )
    keys, controls = {"mouthSmile_L": 0.25, 'a "key"': -0.5}, {"Hinge rotation x": 0.2}
    second = Example("笑", "Bär", rng.normal(size=N_FEATURES), keys=keys, controls=controls, muted=True)
    return Style((first, second))


def test_a_style_is_the_same_after_a_round_trip(tmp_path):
    path = tmp_path / "artist.facestyle"
    save_style(style(), path)
    for read, written in zip(load_style(path).examples, style().examples, strict=True):
        np.testing.assert_array_equal(read.expression, written.expression)
        np.testing.assert_array_equal(read.offsets, written.offsets)
        names = ("name", "performer", "keys", "controls", "weight", "muted", "thumbnail")
        assert [getattr(read, name) for name in names] == [getattr(written, name) for name in names]
    save_style(Style(), path)
    assert load_style(path) == Style()


@pytest.mark.parametrize("length", [0, 10, 300, -1])
def test_damaged_files_are_one_error(tmp_path, length):
    path = tmp_path / "artist.facestyle"
    save_style(style(), path)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(SourceError, match=r"artist\.facestyle cannot be read"):
        load_style(path)


def test_other_files_missing_ones_and_folders_are_refused(tmp_path):
    with pytest.raises(SourceError):
        load_style(tmp_path / "missing.facestyle")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(SourceError):
        load_style(tmp_path / "other.npz")
    with pytest.raises(OutputError):
        save_style(style(), tmp_path)


@pytest.mark.parametrize(
    "example",
    [
        Example("a", "", np.full(N_FEATURES, 1e9)),
        Example("a", "", np.full(N_FEATURES, np.nan)),
        Example("a", "", np.zeros(N_FEATURES), np.full((3, 3), 1e20, np.float32)),
        Example("a", "", np.zeros(N_FEATURES), weight=9.0),
        Example("a", "", np.zeros(N_FEATURES), keys={"a": 1e9}),
        Example("a", "", np.zeros(N_FEATURES), controls={"a": 1e9}),
        Example("a" * 300, "", np.zeros(N_FEATURES)),
    ],
)
def test_values_that_no_head_has_are_refused(tmp_path, example):
    save_style(Style((example,)), tmp_path / "a.facestyle")
    with pytest.raises(SourceError):
        load_style(tmp_path / "a.facestyle")


def test_a_style_fits_a_head_with_as_many_vertices_or_by_its_keys():
    assert [len(example.offsets) for example in style().fitted_to(12).examples] == [12, 0]
    with pytest.raises(HeadError, match="Smile was taught on a mesh with 12 vertices, but this head has 13"):
        style().fitted_to(13)


def test_a_thumbnail_shows_the_head_and_other_pictures_are_none():
    rig = built_in_head()
    pixels = pixels_of(thumbnail(rig, rig.all_vertices))
    assert pixels.shape == (SIDE, SIDE, 4) and pixels[..., 0].max() > 0.6 and pixels[..., 0].std() > 0.1
    assert pixels[SIDE // 2, SIDE // 2, 0] > 0.4 and pixels_of(b"picture" * 9) is None and pixels_of(b"") is None


def test_a_style_of_an_earlier_version_has_no_controls(tmp_path):
    stored = dict(np.load(io.BytesIO(style_bytes(style()))))
    described = json.loads(str(stored["style"]))
    for example in described["examples"]:
        del example["controls"]
    stored["style"] = np.array(json.dumps(described))
    np.savez(path := tmp_path / "old.npz", **stored)
    assert not any(example.controls for example in style_of(path.read_bytes()).examples)


def test_an_example_of_controls_fits_any_mesh():
    example = replace(style().examples[0], controls={"Hinge rotation x": 0.2})
    (kept,) = Style((example,)).fitted_to(7, ()).examples
    assert kept.controls == example.controls and not len(kept.offsets)
