"""Fuzzes a format in a process of its own, with limited memory and time per case.

    python -m tests.fuzz.run FORMAT --count 2000 [--first 0] [--case N]

A case that takes too long, or ends the process, is told by the number in `--progress`; `--case` makes one again.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path
from random import Random

import cv2

from facemime.core.errors import FacemimeError
from facemime.core.numeric import linalg

from .formats import FORMATS, Format

SECONDS = 10.0
"""Limit of a case."""
_SCIPY = ("interpolate", "ndimage", "sparse.csgraph", "sparse.linalg", "spatial.distance", "spatial.transform")
"""Parts of scipy that core loads when it first needs them. Loaded while memory is limited, their libraries crash or
hang."""


def main() -> None:
    """Run the cases, and print their results as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("format", choices=sorted(FORMATS))
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--case", type=int)
    parser.add_argument("--progress", type=Path)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    chosen = FORMATS[arguments.format]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"case{chosen.suffix}"
        path.write_bytes(chosen.intact())
        chosen.read(path)
        for part in _SCIPY:
            linalg.part(part)
        limit = _memory(chosen.megabytes)
        cases = range(arguments.first, arguments.count) if arguments.case is None else [arguments.case]
        outcomes: Counter[str] = Counter()
        failures: list[tuple[int, str]] = []
        for case in cases:
            if arguments.progress is not None:
                arguments.progress.write_text(json.dumps([case, outcomes, failures]))
            outcome, told = _one(chosen, arguments.format, case, path, limit)
            outcomes[outcome] += 1
            if arguments.case is not None:
                print(outcome, told, file=sys.stderr)
            if outcome not in ("read", "refused") and len(failures) < 20:
                failures.append((case, told))
    print(json.dumps([None, outcomes, failures]))


def _memory(megabytes: int) -> int:
    """Bytes of memory that the process has now, and so many more."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * os.sysconf("SC_PAGE_SIZE") + megabytes * 2**20


def _one(chosen: Format, name: str, case: int, path: Path, limit: int) -> tuple[str, str]:
    path.write_bytes(chosen.mutated(Random(f"{name} {case}")))  # which may take more memory than reading it should
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (limit, most))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)  # ends the process, whatever it is doing
    try:
        chosen.read(path)
    except FacemimeError as error:
        sound = str(error).strip() and len(str(error)) < 2000
        return ("refused", str(error)) if sound else ("unclear", f"{str(error)[:200]!r}")
    except Exception as error:
        return type(error).__name__, "".join(traceback.format_exception(error)[-3:])[-1500:]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    return "read", ""


if __name__ == "__main__":
    main()
