"""The commands `batch` for many clips, and `clip` for one of them, which `batch` runs in processes."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..core.errors import FacemimeError, SourceError
from ..core.files.capture import VideoSource
from ..core.files.locks import lock_of, sweep
from ..core.files.writing import check_writable, locked
from ..core.puppet.job import PuppetJob
from ..core.takes.file import SUFFIX, load_take
from ..core.takes.take import Take
from ..core.tracking.overlay import draw_frame
from .clips import Clip, Namer, find_clips, read_record, worst_frames, write_record
from .console import Progress, printable, tell
from .options import (
    Commands,
    add_command,
    add_output,
    add_preset_option,
    add_puppet_options,
    as_options,
    puppet_job,
    whole_number,
)
from .puppet import run_puppet
from .report import Entry, jpeg_of, write_report
from .runners import DaskRunner, LocalRunner, Outcome, Runner
from .stopping import INTERRUPTED

_SOURCES = "videos, folders, or text files with one path per line"
_OUTPUT = "output folder for each clip's .blend, .facetake, .png and record; clips that are done are skipped"
_THUMBNAIL = (240, 180)
_MAX_STATUS = 99


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    clip = add_command(commands, "clip", "process one clip of a batch, unless it is done; used by batch")
    clip.add_argument("source", type=Path, metavar="VIDEO|FOLDER|LIST", help=_SOURCES)
    clip.add_argument(
        "--number", type=whole_number, metavar="N", help="number of the clip in the folder or the list, from 1"
    )
    add_output(clip, "DIR", _OUTPUT)
    add_preset_option(clip)
    add_puppet_options(clip)
    clip.set_defaults(run=lambda given: _run_clip(puppet_job(given), given["number"]))

    batch = add_command(
        commands,
        "batch",
        "animate a head from each of many clips; the exit status is the number of failures, at most 99",
    )
    batch.add_argument("sources", nargs="+", type=Path, metavar="FOLDER|LIST|VIDEO", help=_SOURCES)
    add_output(batch, "DIR", f"{_OUTPUT}; report.html is written here, too")
    jobs = max(1, (os.cpu_count() or 2) // 2)
    batch.add_argument(
        "--jobs",
        type=whole_number,
        default=jobs,
        metavar="N",
        help=f"number of clips to process at a time ({jobs}, half the cores)",
    )
    batch.add_argument("--dask", metavar="ADDRESS", help="use the workers of this Dask scheduler")
    add_preset_option(batch)
    add_puppet_options(batch)
    batch.set_defaults(
        run=lambda given: _run_batch(
            puppet_job(given, source=given["sources"][0]), *(given[name] for name in ("sources", "jobs", "dask"))
        )
    )


def _run_clip(job: PuppetJob, number: int | None) -> int:
    """Run `facemime clip`: a clip to a head, a take, a sheet and a record; concurrent runs process it once.

    The source of the job is a clip, a folder or a list, in which the clip has a number from 1; its output is the output
    folder.
    """
    folder = job.output
    clip = Namer(job).clip(_chosen(find_clips([job.source]), number))
    check_writable(clip.output(folder, ".json"))
    with locked(lock_of(clip.output(folder, ".json"))):
        sweep(folder)
        if read_record(clip, folder) is not None:
            return 0
        started = time.monotonic()
        take = clip.output(folder, SUFFIX)
        output, sheet = clip.output(folder, ".blend"), clip.output(folder, ".png")
        if status := run_puppet(replace(job, source=clip.path.absolute(), output=output, take=take, sheet=sheet)):
            return status
        tracked = load_take(take)
        write_record(clip, folder, tracked, time.monotonic() - started, _thumbnails(clip.path, tracked))
    return 0


def _run_batch(job: PuppetJob, sources: Sequence[Path], jobs: int, dask: str | None) -> int:
    """Run `facemime batch`: process all clips that are not done, and write a report of all.

    The output of the job, which is that of each clip, is the output folder. `jobs` clips are processed at a time on
    this machine, or all by the workers of a scheduler at the address `dask`. Returns the exit status: the number of
    failures, at most 99.
    """
    folder = job.output
    clips = find_clips(sources)
    check_writable(folder / "report.json")
    if jobs < 1:
        raise FacemimeError(
            "The number of clips at a time must be at least 1; got {jobs}. Use --jobs 1 or more.", jobs=jobs
        )
    if dask is None and importlib.util.find_spec("bpy") is None:
        raise FacemimeError("batch needs Blender. Run: blender --command facemime batch ..., or install bpy.")
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    runner: Runner = LocalRunner(jobs) if dask is None else DaskRunner(dask)
    named, failures = _named(clips, Namer(job))
    before = {name for name, clip in named.items() if read_record(clip, folder) is not None}
    todo = [clip for name, clip in named.items() if name not in before]
    lines = [["clip", str(clip.path.absolute()), "-o", str(folder.absolute()), *as_options(job)] for clip in todo]
    ended, interrupted = _run(runner, lines, len(named))
    messages = {todo[outcome.index].name: outcome.said or f"ended with status {outcome.status}" for outcome in ended}
    entries = failures + [_entry(clip, folder, clip.name in before, messages.get(clip.name)) for clip in named.values()]
    failed = [entry for entry in entries if entry.status == "failed"]
    for entry in failed:
        last = (entry.said.splitlines() or ["no reason was given"])[-1]
        tell(f"facemime: {entry.clip}: {last.removeprefix('facemime: ')}")
    write_report(entries, folder)
    tell(f"facemime: {len(failed)} of {len(entries)} clips failed; see {folder / 'report.html'}.")
    if interrupted:
        tell("facemime: interrupted. Run the same command again to continue.")
    return INTERRUPTED if interrupted else min(len(failed), _MAX_STATUS)


def _run(runner: Runner, lines: Sequence[Sequence[str]], total: int) -> tuple[list[Outcome], bool]:
    """Outcomes of the lines that ended, and whether the user interrupted the batch."""
    progress = Progress("Puppeting", total, unit="clips")
    before = total - len(lines)
    progress.update(before)
    ended: list[Outcome] = []
    try:
        for outcome in runner.run(lines):
            ended.append(outcome)
            progress.update(before + len(ended))
    except KeyboardInterrupt:
        return ended, True
    finally:
        runner.close()
        progress.finish()
    return ended, False


def _named(clips: Sequence[Path], namer: Namer) -> tuple[dict[str, Clip], list[Entry]]:
    """The clips by name, the same content once, and an entry for each clip that cannot be read."""
    named: dict[str, Clip] = {}
    failures: list[Entry] = []
    for path in clips:
        try:
            clip = namer.clip(path)
        except SourceError as error:
            failures.append(Entry(printable(path.name), "failed", said=printable(str(error))))
        else:
            named.setdefault(clip.name.rpartition("-")[2], clip)
    return {clip.name: clip for clip in named.values()}, failures


def _entry(clip: Clip, folder: Path, before: bool, said: str | None) -> Entry:
    """The entry of a clip in the report; its record decides whether it is done."""
    if (record := read_record(clip, folder)) is not None:
        return Entry(printable(clip.path.name), "skipped" if before else "done", clip.name, record=record)
    return Entry(printable(clip.path.name), "not reached" if said is None else "failed", clip.name, said or "")


def _chosen(clips: Sequence[Path], number: int | None) -> Path:
    if number is None and len(clips) == 1:
        return clips[0]
    if number is None or not 1 <= number <= len(clips):
        raise SourceError("There are {clips} clips. Choose one: --number 1 to --number {clips}.", clips=len(clips))
    return clips[number - 1]


def _thumbnails(clip: Path, take: Take) -> list[bytes]:
    """The least certain frames with their landmarks, as JPEG."""
    wanted, pictures = worst_frames(take), []
    with VideoSource(clip) as source:
        for frame in source:
            if frame.index in wanted:
                landmarks = take.landmarks[frame.index].astype(float)
                pictures.append(jpeg_of(draw_frame(frame.image, landmarks, *_THUMBNAIL)))
            if len(pictures) == len(wanted):
                break
    return pictures
