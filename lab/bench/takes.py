"""Speed and size of takes, recovery of truncated ones, and speed and accuracy of bakes: `python -m lab.bench.takes`.

The sample clip is tracked once; its frames, repeated to a minute at 30 per second, are written as a recording is.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from facemime.core.takes.file import TakeWriter, load_take, save_take, take_of
from facemime.core.takes.format import HEADER, LAYOUT, Chunk, chunks_in, frames_content
from facemime.core.takes.from_video import track_video
from facemime.core.takes.spreadsheet import to_csv
from facemime.core.takes.take import FIELDS, Take
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.bakes import bake_tables
from lab.bench.report import Table, bars, finish, parser

ROOT = Path(__file__).resolve().parents[2]
FPS, MINUTE = 30.0, 1800


def main() -> int:
    """Run the benchmark; returns the exit status, 1 if a truncated file was not read correctly."""
    arguments = parser(__doc__ or "").parse_args()
    clip = track_video(ROOT / "assets" / "sample" / "sample.mp4", FaceTracker.load())
    take = a_minute(clip)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.facetake"
        rates = measure_rates(take, path)
        sizes = measure_sizes(take, path)
        save_take(take.part(slice(0, 2 * int(FPS))), path)  # a minute would take too long to read for each cut
        recovery = measure_recovery(path.read_bytes())
    tables = [
        Table("Writing and reading a minute at 30 frames per second", ("what", "s", "frames/s"), rates),
        Table("Size of a minute", ("what", "kB"), sizes),
        Table(
            "Two seconds, truncated at every byte of the last chunk",
            ("recovered", "truncations"),
            sorted(recovery.items()),
        ),
        *bake_tables(clip),
    ]
    finish(arguments, tables, {"rates": rates, "sizes": sizes, "recovery": recovery})
    if arguments.figure is not None:
        bars(
            arguments.figure,
            "A minute of a take, by content",
            *zip(*sizes[2:], strict=True),
            "kB, each compressed alone",
        )
    return int(any("wrong" in what for what in recovery))


def a_minute(take: Take) -> Take:
    """`take`, forwards and backwards until it is a minute long at 30 frames per second."""
    rows = np.resize(np.concatenate([np.arange(len(take)), np.arange(len(take))[::-1]]), MINUTE)
    return replace(take.part(rows), times=np.arange(MINUTE) / FPS)


def measure_rates(take: Take, path: Path) -> list[tuple[str, float, float]]:
    """Seconds, and frames per second, of writing and reading; writes the take to `path`."""
    results = [take.result(frame) for frame in range(len(take))]
    rows = []

    def measure(what: str, work) -> None:
        start = time.perf_counter()
        work()
        seconds = time.perf_counter() - start
        rows.append((what, seconds, len(take) / seconds))

    def record(sync: bool) -> None:
        path.unlink(missing_ok=True)
        with TakeWriter(path, take.info, sync=sync) as writer:
            for when, result in zip(take.times.tolist(), results, strict=True):
                writer.append(when, result)

    measure("recorded, flushed to disk every second", lambda: record(True))
    measure("recorded, flushed by the system", lambda: record(False))
    measure("saved", lambda: save_take(take, path))
    measure("loaded", lambda: load_take(path))
    measure("exported as CSV", lambda: to_csv(take, path.with_suffix(".csv")))
    return rows


def measure_sizes(take: Take, path: Path) -> list[tuple[str, float]]:
    """Kilobytes of the file, of a numpy archive, and of each array alone."""
    np.savez_compressed(path.with_suffix(".npz"), **{name: getattr(take, name) for name in FIELDS})
    rows = [("the take", path.stat().st_size / 1e3), ("as .npz", path.with_suffix(".npz").stat().st_size / 1e3)]
    nothing = replace(take, **{name: np.zeros_like(getattr(take, name)) for name, _, _ in LAYOUT})
    empty = sum(len(frames_content(part)) for part in seconds_of(nothing))
    for name, _, _ in LAYOUT:
        alone = replace(nothing, **{name: getattr(take, name)})
        rows.append((name, (sum(len(frames_content(part)) for part in seconds_of(alone)) - empty) / 1e3))
    return rows


def seconds_of(take: Take) -> list[Take]:
    """Parts of the take with the length of a chunk."""
    return [take.part(slice(first, first + int(FPS))) for first in range(0, len(take), int(FPS))]


def measure_recovery(data: bytes) -> Counter[str]:
    """Results of truncating the file at each byte of the last chunk, compared with the whole take."""
    whole = take_of(data)
    chunks = [chunk for chunk in chunks_in(data) if isinstance(chunk, Chunk)]
    start = sum(HEADER.size + len(chunk.content) for chunk in chunks[:-2])
    length = HEADER.size + len(chunks[-2].content)
    outcomes: Counter[str] = Counter()
    for cut in range(start, start + length + 1):
        part = take_of(data[:cut])
        same = all(np.array_equal(getattr(part, f), getattr(whole, f)[: len(part)], equal_nan=True) for f in FIELDS)
        report = "reported" if "recovered" in part.info else "wrong: not reported"
        outcomes[f"{len(part)} of {len(whole)} frames, {report}" if same else "wrong: different values"] += 1
    return outcomes


if __name__ == "__main__":
    sys.exit(main())
