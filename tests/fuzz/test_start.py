"""Every fuzzer starts: what it makes intact is read, and what it damages is read or refused."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path
from random import Random

import pytest

from facemime.core.base.errors import FacemimeError
from tests.fuzz.formats import FORMATS
from tests.helpers.blenders import ROOT

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the fuzzers need Linux")
CASES = 3


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_an_intact_file_is_read_and_damaged_ones_are_made(name, tmp_path):
    chosen = FORMATS[name]
    path = tmp_path / f"case{chosen.suffix}"
    path.write_bytes(chosen.intact())
    chosen.read(path)
    for case in range(CASES):
        path.write_bytes(chosen.mutated(Random(f"{name} {case}")))
        with contextlib.suppress(FacemimeError):
            chosen.read(path)


def test_the_program_that_fuzzes_a_format_starts(tmp_path):
    line = [
        sys.executable,
        "-m",
        "tests.fuzz.run",
        "head",
        "--count",
        "2",
        "--progress",
        str(tmp_path / "progress.json"),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(line, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


def test_random_sequences_start(tmp_path):
    pytest.importorskip("bpy")
    program = Path(__file__).with_name("sequences.py")
    line = [sys.executable, str(program), "0", "1", "2", str(tmp_path)]
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path), "HOME": str(tmp_path)}
    done = subprocess.run(line, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "done", done.stdout + done.stderr
    assert "fault " not in done.stdout
