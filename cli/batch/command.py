"""The commands of `facemime` for many clips: batch, and clip, of which batch runs one a process."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ...core.capture import VideoSource
from ...core.errors import FacemimeError, SourceError
from ...core.files import check_writable, locked
from ...core.locks import lock_of, sweep
from ...core.puppet.job import PuppetJob
from ...core.takes.file import SUFFIX, load_take
from ...core.takes.take import Take
from ...core.tracking.overlay import draw_frame
from ..puppet.command import run_puppet
from ..terminal.console import Progress, printable, tell
from ..terminal.options import (
    Commands,
    add_command,
    add_output,
    add_puppet_options,
    as_options,
    puppet_job,
    whole_number,
)
from ..terminal.stopping import INTERRUPTED
from .clips import Clip, Namer, find_clips, read_record, worst_frames, write_record
from .report import Entry, jpeg_of, write_report
from .run import DaskRunner, LocalRunner, Outcome, Runner

_SOURCES = "videos, folders of them, or a text with a path a line"
_OUTPUT = "where each clip's .blend, .facetake, .png and record go; what is there already is not done again"
_THUMBNAIL = (240, 180)
_MOST_FAILED = 99


def add_commands(commands: Commands) -> None:
    """Make the commands known to the parser."""
    clip = add_command(commands, "clip", "puppet one of many clips, if that is not done yet; what batch runs")
    clip.add_argument("source", type=Path, metavar="VIDEO|FOLDER|LIST", help=_SOURCES)
    clip.add_argument("--number", type=whole_number, metavar="N", help="which clip of the folder or the list, from 1")
    add_output(clip, "DIR", _OUTPUT)
    add_puppet_options(clip)
    clip.set_defaults(run=lambda a: run_clip(puppet_job(a, a.source, a.output), a.number))

    batch = add_command(commands, "batch", "puppet many clips; the exit status is how many failed, 99 at most")
    batch.add_argument("sources", nargs="+", type=Path, metavar="FOLDER|LIST|VIDEO", help=_SOURCES)
    add_output(batch, "DIR", f"{_OUTPUT}; and report.html")
    jobs = max(1, (os.cpu_count() or 2) // 2)
    batch.add_argument(
        "--jobs", type=whole_number, default=jobs, metavar="N", help=f"clips at a time (half the cores: {jobs})"
    )
    batch.add_argument("--dask", metavar="ADDRESS", help="on the workers of this Dask scheduler instead of here")
    add_puppet_options(batch)
    batch.set_defaults(run=lambda a: run_batch(puppet_job(a, a.sources[0], a.output), a.sources, a.jobs, a.dask))


def run_clip(job: PuppetJob, number: int | None) -> int:
    """`facemime clip`: one clip to a head, a take, a sheet and a record; two at once do it once.

    Parameters
    ----------
    job : PuppetJob
        Its source is a clip, a folder or a list of them, its output the folder of outputs.
    number : int, optional
        Which clip of a folder or a list, from 1.
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
        wanted = {"output": clip.output(folder, ".blend"), "take": take, "sheet": clip.output(folder, ".png")}
        if status := run_puppet(replace(job, source=clip.path.absolute(), **wanted)):
            return status
        tracked = load_take(take)
        write_record(clip, folder, tracked, time.monotonic() - started, _thumbnails(clip.path, tracked))
    return 0


def run_batch(job: PuppetJob, sources: Sequence[Path], jobs: int, dask: str | None) -> int:
    """`facemime batch`: every clip that is not done yet, and a report of all; returns how many failed, 99 at most.

    Parameters
    ----------
    job : PuppetJob
        What is done with each clip; its output is the folder of outputs.
    sources : sequence of Path
        Clips, folders and lists of them.
    jobs : int
        Clips at a time on this machine.
    dask : str, optional
        Address of a scheduler whose workers run the clips instead.
    """
    folder = job.output
    clips = find_clips(sources)
    check_writable(folder / "report.json")
    if jobs < 1:
        raise FacemimeError(f"At least one clip has to run at a time; got {jobs}. Give --jobs 1 or more.")
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
    said = {todo[outcome.index].name: outcome.said or f"ended with status {outcome.status}" for outcome in ended}
    entries = failures + [_entry(clip, folder, clip.name in before, said.get(clip.name)) for clip in named.values()]
    failed = [entry for entry in entries if entry.status == "failed"]
    for entry in failed:
        last = (entry.said.splitlines() or ["no reason was told"])[-1]
        tell(f"facemime: {entry.clip}: {last.removeprefix('facemime: ')}")
    write_report(entries, folder)
    tell(f"facemime: {len(failed)} of {len(entries)} clips failed; see {folder / 'report.html'}.")
    if interrupted:
        tell("facemime: interrupted. The same line again goes on where this one ended.")
    return INTERRUPTED if interrupted else min(len(failed), _MOST_FAILED)


def _run(runner: Runner, lines: Sequence[Sequence[str]], total: int) -> tuple[list[Outcome], bool]:
    """How each line ended that did, and whether the user stopped before all had."""
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
    """What the report tells of a clip: that it is done is known by its record alone."""
    if (record := read_record(clip, folder)) is not None:
        return Entry(printable(clip.path.name), "skipped" if before else "done", clip.name, record=record)
    return Entry(printable(clip.path.name), "not reached" if said is None else "failed", clip.name, said or "")


def _chosen(clips: Sequence[Path], number: int | None) -> Path:
    if number is None and len(clips) == 1:
        return clips[0]
    if number is None or not 1 <= number <= len(clips):
        raise SourceError(f"There are {len(clips)} clips. Choose one: --number 1 to --number {len(clips)}.")
    return clips[number - 1]


def _thumbnails(clip: Path, take: Take) -> list[bytes]:
    """The frames of which the tracker was least sure, with its landmarks, as JPEG."""
    wanted, pictures = worst_frames(take), []
    with VideoSource(clip) as source:
        for frame in source:
            if frame.index in wanted:
                landmarks = take.landmarks[frame.index].astype(float)
                pictures.append(jpeg_of(draw_frame(frame.image, landmarks, *_THUMBNAIL)))
            if len(pictures) == len(wanted):
                break
    return pictures
