"""Run every live and window test again and again, with two busy processes for each core beside them.

Usage: python tools/stress.py [RUNS] [--live | --windows]; 50 runs of both by default. Prints a line for each run, then
how many failed, which is also the exit status. A test that fails once here races the clock: mend that, not the load.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIVE = sorted(
    str(path.relative_to(ROOT))
    for name in ("live*", "reference_video", "recording", "pose_targets", "takes_list", "random_sequences")
    for path in ROOT.glob(f"tests/*/test_{name}.py")
)
WINDOWS = ["tests/gui"]


def main() -> int:
    """Run; returns how many runs failed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("runs", type=int, nargs="?", default=50, help="how often (50)")
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--live", action="store_true", help="tests of live sessions alone")
    chosen.add_argument("--windows", action="store_true", help="tests in windows alone")
    arguments = parser.parse_args()
    tests = (LIVE if not arguments.windows else []) + (WINDOWS if not arguments.live else [])
    failed = 0
    with busy(2 * (os.cpu_count() or 2)):
        for run in range(arguments.runs):
            began = time.monotonic()
            done = subprocess.run(
                [sys.executable, "-m", "pytest", *tests], cwd=ROOT, capture_output=True, text=True, check=False
            )
            failed += done.returncode != 0
            last = done.stdout.strip().splitlines()[-1:]
            print(f"{run + 1:3d}  {time.monotonic() - began:6.1f} s  {''.join(last)}", flush=True)
            if done.returncode:
                print(
                    "\n".join(line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR", "E  ")))
                )
    print(f"{failed} of {arguments.runs} runs failed")
    return failed


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep `count` processes counting."""
    processes = [multiprocessing.Process(target=_count, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()


def _count() -> None:
    while True:
        sum(range(1_000_000))


if __name__ == "__main__":
    sys.exit(main())
