"""The report of a batch and the names of its clips: `python -m lab.bench.batch [--clips 10000]`.

Records are those of a real clip of 250 frames with its pictures, one for each of many clips that are small files. It
measures the time and the largest memory of naming all clips, first and again, and of writing the report.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from facemime.cli.batch import _entry, _named
from facemime.cli.clips import CHECKSUMS, PICTURES, Checksums, Clip, Namer
from facemime.cli.report import Report
from facemime.core.puppet.job import PuppetJob
from lab.bench.report import Table, finish, parser

_SHARES = (10, 3, 1)
"""Parts of the clips, to see what grows with their number."""


def make_clips(folder: Path, count: int) -> list[Path]:
    """Write small files of different content, which are older than the clock's grain."""
    folder.mkdir()
    clips = [folder / f"clip-{number:06d}.mp4" for number in range(count)]
    for number, path in enumerate(clips):
        path.write_text(str(number))
        os.utime(path, (1e9, 1e9))
    return clips


def make_records(clips: list[Clip], folder: Path) -> None:
    """Write a record for each clip: 300 points of confidence, and pictures of usual size as links to the same files."""
    (folder / PICTURES).mkdir()
    shared = [folder / PICTURES / name for name in ("small.jpg", "sheet.jpg")]
    for path, size in zip(shared, (9_000, 40_000), strict=True):
        path.write_bytes(os.urandom(size))
    for number, clip in enumerate(clips):
        clip.output(folder, ".blend").touch()
        names = [f"{clip.name}-{end}.jpg" for end in ("1", "2", "3", "sheet")]
        for name in names:
            os.link(shared[name.endswith("sheet.jpg")], folder / PICTURES / name)
        curve = [round(0.5 + 0.499 * ((number * 37 + point) % 101) / 101, 3) for point in range(300)]
        record = {"clip": clip.path.name, "outputs": [f"{clip.name}.blend"], "frames": 250, "found": 250}
        record |= {"length": 10.0, "seconds": 9.0, "confidence": curve, "worst": [1.0, 4.0, 8.0], "pictures": names}
        clip.output(folder, ".json").write_text(json.dumps(record))


def measured(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds and MiB that a function takes, in a process of its own."""
    receiver, sender = multiprocessing.Pipe(duplex=False)

    def run() -> None:
        before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
        work()
        taken = time.perf_counter() - start
        sender.send((taken, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0))

    process = multiprocessing.get_context("fork").Process(target=run)
    process.start()
    result = receiver.recv()
    process.join()
    return float(result[0]), float(result[1])


def measure(count: int, folder: Path) -> list[list[object]]:
    """Rows of one number of clips."""
    clips, out = make_clips(folder / "clips", count), folder / "out"
    out.mkdir()
    namer = Namer(job := PuppetJob(clips[0], out))
    rows: list[list[object]] = []
    for what in ("name clips", "name clips again"):
        rows.append([count, what, *measured(lambda: _named(clips, Namer(job, Checksums(out))))])
    make_records([namer.clip(path) for path in clips], out)

    def report() -> None:
        named, entries = _named(clips, Namer(job, Checksums(out)))
        entries += [_entry(clip, out, before=True) for clip in named]
        Report(entries, out).finish()

    rows.append([count, "name clips, read records, write the report", *measured(report)])
    pages = list((out / PICTURES).glob("*.html")) + [out / "report.html"]
    print(
        count, "clips:", len(pages), "pages of", sum(page.stat().st_size for page in pages) // 1024, "KiB", flush=True
    )
    assert (out / CHECKSUMS).exists()
    return rows


def main() -> None:
    """Measure, and print."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--clips", type=int, default=10_000, help="number of clips (10000)")
    options = arguments.parse_args()
    rows = []
    for part in _SHARES:
        with tempfile.TemporaryDirectory() as folder:
            rows += measure(options.clips // part, Path(folder))
    finish(options, [Table("Many clips", ("clips", "what", "s", "MiB more"), rows)], {"rows": rows})
    sys.stdout.flush()


if __name__ == "__main__":
    main()
