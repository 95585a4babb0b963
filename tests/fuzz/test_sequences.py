"""Random sequences of steps neither crash Blender nor raise, in any version of Blender."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.helpers.blenders import ROOT, blender_python, unpack_wheels

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform != "linux", reason="the environments are Linux ones"),
]
COUNT = int(os.environ.get("FACEMIME_SEQUENCES", "60"))
STEPS = 30
BLENDERS_OWN = frozenset({"add cube"})
"""Steps that, in some sequence, also crash Blender without Facemime; found by replaying it with `--bare`.

Adding a cube: Blender 5.2 without a window, after it opened a file that was saved in Sculpt Mode.
"""


@dataclass
class Outcome:
    """Results of sequences.

    Attributes
    ----------
    played : int
    faults : list of str
        The step and its traceback, for each that no user should see.
    ended : list of (int, str, int)
        Seed and step that Blender did not survive, and its exit status.
    """

    played: int = 0
    faults: list[str] = field(default_factory=list)
    ended: list[tuple[int, str, int]] = field(default_factory=list)


class Player:
    """Plays sequences in one Blender, which is restarted whenever it ends."""

    def __init__(self, version: str, folder: Path) -> None:
        self._python, self._folder = blender_python(version), folder
        paths = folder / "paths"
        paths.mkdir()
        (paths / "facemime").symlink_to(ROOT)
        unpack_wheels(self._python, paths)
        inherited = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST", "VIRTUAL_ENV"))}
        self._environment = inherited | {
            "PYTHONPATH": str(paths),
            "PYTHONDONTWRITEBYTECODE": "1",
            "BLENDER_USER_RESOURCES": str(folder / "profile"),
        }

    def play(self, first: int, count: int, *options: str) -> Outcome:
        """Play `count` sequences from number `first`."""
        outcome, last = Outcome(), first + count
        while first < last:
            printed, status = self._run(first, last - first, *options)
            seeds = [int(line.split()[1]) for line in printed.splitlines() if line.startswith("seed ")]
            outcome.played += len(seeds)
            outcome.faults += ["fault " + part.partition("\nstep ")[0] for part in printed.split("\nfault ")[1:]]
            if status == 0:
                break
            assert seeds, printed
            step = [line for line in printed.splitlines() if line.startswith("step ")][-1].split(" ", 2)[2]
            outcome.ended.append((seeds[-1], step, status))
            first = seeds[-1] + 1
        return outcome

    def _run(self, first: int, count: int, *options: str) -> tuple[str, int]:
        program = str(Path(__file__).with_name("sequences.py"))
        line = [str(self._python), program, str(first), str(count), str(STEPS), str(self._folder), *options]
        done = subprocess.run(line, env=self._environment, capture_output=True, text=True, check=False)
        return done.stdout, done.returncode


@pytest.mark.parametrize("version", ["4.2", "4.5", "5.2"])
def test_random_sequences_neither_crash_blender_nor_raise(version, tmp_path, capsys):
    player = Player(version, tmp_path)
    outcome = player.play(0, COUNT)
    ours = [end for end in outcome.ended if not player.play(end[0], 1, "--bare").ended]
    with capsys.disabled():
        counts = f"{outcome.played} sequences, {len(outcome.faults)} tracebacks, {len(outcome.ended)} ends of Blender"
        print(f"\nBlender {version}: {counts}, {len(outcome.ended) - len(ours)} of them without Facemime too")
    assert outcome.played == COUNT
    assert not outcome.faults, f"{Counter(fault.splitlines()[0] for fault in outcome.faults)}\n{outcome.faults[0]}"
    assert not ours, ours
    assert {step for _, step, _ in outcome.ended} <= BLENDERS_OWN
