"""The commands of `facemime` for many clips: batch, and clip, of which batch runs one a process."""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from collections.abc import Sequence
from pathlib import Path

from ...core.capture import VideoSource
from ...core.errors import FacemimeError, SourceError
from ...core.files import check_writable, locked
from ...core.locks import lock_of, sweep
from ...core.takes.file import SUFFIX, load_take
from ...core.takes.take import Take
from ...core.tracking.overlay import picture_of_frame
from ..terminal.console import Progress, printable, tell
from ..terminal.options import (
    Commands,
    add_bake_options,
    add_command,
    add_head_options,
    add_output,
    as_line,
    settings_of,
    whole_number,
)
from ..terminal.stopping import INTERRUPTED
from .clips import Job, Namer, find_clips, read_record, worst_frames, write_record
from .report import Entry, jpeg_of, write_report
from .run import DaskRunner, LocalRunner, Runner

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
    add_head_options(clip)
    add_bake_options(clip)
    clip.set_defaults(run=run_clip)

    batch = add_command(commands, "batch", "puppet many clips; the exit status is how many failed, 99 at most")
    batch.add_argument("sources", nargs="+", type=Path, metavar="FOLDER|LIST|VIDEO", help=_SOURCES)
    add_output(batch, "DIR", f"{_OUTPUT}; and report.html")
    jobs = max(1, (os.cpu_count() or 2) // 2)
    batch.add_argument(
        "--jobs", type=whole_number, default=jobs, metavar="N", help=f"clips at a time (half the cores: {jobs})"
    )
    batch.add_argument("--dask", metavar="ADDRESS", help="on the workers of this Dask scheduler instead of here")
    add_head_options(batch)
    add_bake_options(batch)
    batch.set_defaults(run=run_batch)


def run_clip(arguments: argparse.Namespace) -> int:
    """`facemime clip`: one clip to a head, a take, a sheet and a record; two at once do it once."""
    from .. import main as cli

    job = Namer(settings_of(arguments)).job(_chosen(find_clips([arguments.source]), arguments.number))
    folder = arguments.output
    outputs = {suffix: str(job.output(folder, suffix)) for suffix in (".blend", SUFFIX, ".png")}
    check_writable(job.output(folder, ".json"))
    with locked(lock_of(job.output(folder, ".json"))):
        sweep(folder)
        if read_record(job, folder) is not None:
            return 0
        started = time.monotonic()
        line = [
            str(job.clip.absolute()),
            "-o",
            outputs[".blend"],
            "--take",
            outputs[SUFFIX],
            "--sheet",
            outputs[".png"],
        ]
        if status := cli.main(["puppet", *line, *as_line(settings_of(arguments))]):
            return status
        take = load_take(Path(outputs[SUFFIX]))
        write_record(job, folder, take, time.monotonic() - started, _thumbnails(job.clip, take))
    return 0


def run_batch(arguments: argparse.Namespace) -> int:
    """`facemime batch`: every clip that is not done yet, and a report of all."""
    folder: Path = arguments.output
    clips = find_clips(arguments.sources)
    check_writable(folder / "report.json")
    if arguments.jobs < 1:
        raise FacemimeError(f"At least one clip has to run at a time; got {arguments.jobs}. Give --jobs 1 or more.")
    if arguments.dask is None and importlib.util.find_spec("bpy") is None:
        raise FacemimeError("batch needs Blender. Run: blender --command facemime batch ..., or install bpy.")
    folder.mkdir(parents=True, exist_ok=True)
    sweep(folder)
    runner: Runner = LocalRunner(arguments.jobs) if arguments.dask is None else DaskRunner(arguments.dask)
    jobs, failures = _jobs(clips, Namer(settings_of(arguments)))
    before = {name for name, job in jobs.items() if read_record(job, folder) is not None}
    todo = [job for name, job in jobs.items() if name not in before]
    said, interrupted = _run(runner, todo, len(jobs), arguments)
    entries = failures + [_entry(job, folder, job.name in before, said.get(job.name)) for job in jobs.values()]
    write_report(entries, folder)
    failed = [entry for entry in entries if entry.status == "failed"]
    for entry in failed:
        last = (entry.said.splitlines() or ["no reason was told"])[-1]
        tell(f"facemime: {entry.clip}: {last.removeprefix('facemime: ')}")
    tell(f"facemime: {len(failed)} of {len(entries)} clips failed; see {folder / 'report.html'}.")
    if interrupted:
        tell("facemime: interrupted. The same line again goes on where this one ended.")
    return INTERRUPTED if interrupted else min(len(failed), _MOST_FAILED)


def _run(runner: Runner, todo: Sequence[Job], total: int, arguments: argparse.Namespace) -> tuple[dict[str, str], bool]:
    """What each clip that ended said, by its job's name, and whether the user stopped before all had."""
    output = ["-o", str(arguments.output.absolute())]
    lines = [["clip", str(job.clip.absolute()), *output, *as_line(settings_of(arguments))] for job in todo]
    progress = Progress("Puppeting", total, unit="clips")
    done = total - len(todo)
    progress.update(done)
    said: dict[str, str] = {}
    try:
        for outcome in runner.run(lines):
            said[todo[outcome.index].name] = outcome.said or f"ended with status {outcome.status}"
            done += 1
            progress.update(done)
    except KeyboardInterrupt:
        return said, True
    finally:
        runner.close()
        progress.finish()
    return said, False


def _jobs(clips: Sequence[Path], namer: Namer) -> tuple[dict[str, Job], list[Entry]]:
    """The jobs by name, the same content once, and an entry for each clip that cannot be read."""
    jobs: dict[str, Job] = {}
    failures: list[Entry] = []
    for clip in clips:
        try:
            job = namer.job(clip)
        except SourceError as error:
            failures.append(Entry(printable(clip.name), "failed", said=printable(str(error))))
        else:
            jobs.setdefault(job.name.rpartition("-")[2], job)
    return {job.name: job for job in jobs.values()}, failures


def _entry(job: Job, folder: Path, before: bool, said: str | None) -> Entry:
    """What the report tells of a clip: that it is done is known by its record alone."""
    if (record := read_record(job, folder)) is not None:
        return Entry(printable(job.clip.name), "skipped" if before else "done", job.name, record=record)
    return Entry(printable(job.clip.name), "not reached" if said is None else "failed", job.name, said or "")


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
                pictures.append(jpeg_of(picture_of_frame(frame.image, landmarks, *_THUMBNAIL)))
            if len(pictures) == len(wanted):
                break
    return pictures
