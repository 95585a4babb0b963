"""Arrays that do not fit into memory."""

import errno
import gc
import os
from pathlib import Path

import numpy as np
import pytest

from facemime.core.bake.fit import fit_basis, left_over, mixed_motion
from facemime.core.errors import OutputError
from facemime.core.files import large_arrays
from facemime.core.files.large_arrays import large_array


@pytest.fixture(params=["reserved", "written"])
def on_disk(request, monkeypatch, tmp_path) -> Path:
    """Keep all arrays in files in a folder, whose space the system reserves or which are written."""
    monkeypatch.setattr(large_arrays, "_IN_MEMORY", 0)
    monkeypatch.setattr(large_arrays, "_BLOCK", 1000)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    if request.param == "written":
        monkeypatch.delattr(os, "posix_fallocate", raising=False)
    elif not hasattr(os, "posix_fallocate"):
        pytest.skip("the system reserves no space")
    return tmp_path


def test_an_array_on_the_disk_is_like_one_in_memory_and_leaves_no_file(on_disk):
    array = large_array((7, 100, 3))
    array[:] = np.arange(2100.0).reshape(7, 100, 3)
    assert isinstance(array, np.memmap) and array.dtype == np.float32
    np.testing.assert_array_equal(array[3:5, ::7].sum(), np.arange(2100.0).reshape(7, 100, 3)[3:5, ::7].sum())
    del array
    gc.collect()
    assert list(on_disk.iterdir()) == []


def test_shape_keys_of_a_motion_on_the_disk_are_those_of_one_in_memory(on_disk, monkeypatch):
    rng = np.random.default_rng(0)
    keys, weights = rng.standard_normal((5, 40, 3)).astype(np.float32), rng.random((150, 5))
    found = []
    for size in (0, 1 << 30):
        monkeypatch.setattr(large_arrays, "_IN_MEMORY", size)
        motion = mixed_motion(keys, weights)
        left, worst = left_over(motion, keys[:3], weights[:, :3])
        assert isinstance(left, np.memmap) == (size == 0)
        found.append((fit_basis(left, 1e-3), worst))
    (one, error), (other, same) = found
    assert error == same and one.worst_error == other.worst_error < 1e-3
    np.testing.assert_array_equal(one.modes, other.modes)


def test_a_full_disk_is_an_error_that_tells_how_much_is_needed(on_disk, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(large_arrays, "_reserve", full)
    with pytest.raises(OutputError, match=r"takes 2\.4 GB, for which .* has no room"):
        large_array((1000, 200_000, 3))
    assert list(on_disk.iterdir()) == []
