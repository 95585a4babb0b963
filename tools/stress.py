"""Run every live and window test again and again on a busy machine: each run has enough others beside it for that.

Usage: python tools/stress.py [RUNS] [--live | --windows]; 50 runs of both by default. So many run at once that each
shares the machine with two busy processes for each core. Prints a line for each run, then how many failed, which is
also the exit status. A test that fails once here races the clock: mend that, not the load.
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
LIVE = sorted(
    str(path.relative_to(ROOT))
    for name in ("live*", "reference_video", "recording", "pose_targets", "takes_list", "random_sequences")
    for path in ROOT.glob(f"tests/*/test_{name}.py")
)
WINDOWS = ["tests/gui"]


@dataclass(frozen=True)
class Run:
    """One run of the tests: seconds, the last line that pytest printed, and what went wrong."""

    seconds: float
    summary: str
    failures: list[str]


def main() -> int:
    """Run; returns how many runs failed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("runs", type=int, nargs="?", default=50, help="how often (50)")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--live", action="store_true", help="tests of live sessions alone")
    chosen.add_argument("--windows", action="store_true", help="tests in windows alone")
    arguments = parser.parse_args()
    tests = (LIVE if not arguments.windows else []) + (WINDOWS if not arguments.live else [])
    at_once = 2 * (os.cpu_count() or 2) + 1
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
    """Run `tests` once, with screenshots in a place of their own."""
    began = time.monotonic()
    with TemporaryDirectory() as shots:
        line = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *tests]
        environment = os.environ | {"FACEMIME_SHOTS": shots, "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    printed = done.stdout.strip().splitlines()
    failures = [text for text in printed if text.startswith(("FAILED", "ERROR", "E  "))]
    if done.returncode and not failures:
        failures = [f"ended with status {done.returncode}"]
    return Run(time.monotonic() - began, "".join(printed[-1:]), failures)


if __name__ == "__main__":
    sys.exit(main())
