"""Damaged files of every format are read, or refused with a FacemimeError, in limited memory and time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

pytest.importorskip("resource", reason="memory is bounded by the system's own limits, which Windows lacks")
if not sys.platform.startswith("linux"):
    pytest.skip("memory is bounded by what Linux tells of a process", allow_module_level=True)

from tests.fuzz.formats import FORMATS

COUNT = int(os.environ.get("FACEMIME_FUZZ_CASES", "2000"))
_MOST_ENDS = 20
"""Crashes of the process after which a format is given up."""


@pytest.mark.thorough
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", sorted(FORMATS))
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outcomes, failures = fuzzed(name, COUNT, tmp_path / "progress.json")
    told = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    with capsys.disabled():
        print(f"\n{name}: {told}")
    assert not failures, f"{told}; first, case {failures[0][0]}:\n{failures[0][1]}"
    assert COUNT < 500 or (outcomes["read"] and outcomes["refused"]), "nothing was tried"


def fuzzed(name: str, count: int, progress: Path) -> tuple[Counter[str], list[tuple[int, str]]]:
    """Number of each outcome, and the first cases that are neither read nor refused."""
    outcomes: Counter[str] = Counter()
    failures: list[tuple[int, str]] = []
    first = 0
    paths = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    for _ in range(_MOST_ENDS):
        line = [sys.executable, "-m", "tests.fuzz.run", name, "--count", str(count), "--first", str(first)]
        done = subprocess.run(
            [*line, "--progress", str(progress)], capture_output=True, text=True, env=environment, check=False
        )
        if done.returncode > 0:
            raise AssertionError(done.stderr)
        last, came, failed = json.loads(done.stdout if done.returncode == 0 else progress.read_text())
        outcomes.update(came)
        failures += [(case, text) for case, text in failed]
        if last is None:
            break
        outcome = "hung" if done.returncode == -14 else f"ended by signal {-done.returncode}"
        outcomes[outcome] += 1
        failures.append((last, outcome))
        first = last + 1
    return outcomes, failures
