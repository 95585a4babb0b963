"""Run all live and window tests repeatedly on a busy machine.

Usage: python tools/stress.py [RUNS] [--live | --windows] [--thorough] [-k EXPRESSION]; 50 runs of both by default, of
the tests that `make test` has. So many runs are started at once that each competes with two busy processes per core.
Prints a line per run, then the number of failed runs, which is also the exit status. A test that fails once has a race
condition: fix that rather than the load.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
_NAMES = ("live*", "stream*", "reference_video", "viewer_server", "takes_list")
LIVE = sorted(
    {
        str(path.relative_to(ROOT))
        for name in _NAMES
        for room in ("blender", "core")
        for path in ROOT.glob(f"tests/{room}/test_{name}.py")
    }
    | {
        str(path.relative_to(ROOT))
        for path in ROOT.glob("tests/blender/test_*.py")
        if "live_ticks" in path.read_text(encoding="utf-8")
    }
)
"""Whatever runs a session, reads a source in real time, or has sockets."""
WINDOWS = ["tests/gui"]


@dataclass(frozen=True)
class Run:
    """A run of the tests: duration in seconds, the last line of pytest's output, and the failures."""

    seconds: float
    summary: str
    failures: list[str]


def main() -> int:
    """Run the tests; return the number of failed runs."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("runs", type=int, nargs="?", default=50, help="number of runs (50)")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--live", action="store_true", help="run only the tests of live sessions")
    chosen.add_argument("--windows", action="store_true", help="run only the tests in windows")
    parser.add_argument("--thorough", action="store_true", help="run those that `make test` leaves out, too")
    parser.add_argument("-k", dest="only", default="", metavar="EXPRESSION", help="run only these tests, as in pytest")
    arguments = parser.parse_args()
    tests = (LIVE if not arguments.windows else []) + (WINDOWS if not arguments.live else [])
    at_once = min(arguments.runs, 2 * (os.cpu_count() or 2) + 1)
    tests += [] if arguments.thorough else ["-m", "not thorough"]
    tests += ["-k", arguments.only] if arguments.only else []
    failed = 0
    with ThreadPoolExecutor(at_once) as pool:
        runs = [pool.submit(run, tests) for _ in range(arguments.runs)]
        for number, done in enumerate(as_completed(runs), 1):
            result = done.result()
            failed += bool(result.failures)
            print(f"{number:3d}  {result.seconds:6.1f} s  {result.summary}", *result.failures, sep="\n", flush=True)
    print(f"{failed} of {arguments.runs} runs failed, {at_once} at once on {os.cpu_count()} cores")
    return failed


def run(tests: list[str]) -> Run:
    """Run `tests` once, with screenshots in a temporary folder."""
    began = time.monotonic()
    with TemporaryDirectory() as shots:
        line = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *tests]
        environment = os.environ | {"FACEMIME_SHOTS": shots, "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    printed = done.stdout.strip().splitlines()
    failures = [text for text in printed if text.startswith(("FAILED", "ERROR", "E  "))]
    if done.returncode and not failures:
        failures = [f"exit status {done.returncode}"]
    return Run(time.monotonic() - began, "".join(printed[-1:]), failures)


if __name__ == "__main__":
    sys.exit(main())
