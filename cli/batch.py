"""The commands `batch` for many clips, and `clip` for some of them, which `batch` runs in processes."""

from __future__ import annotations

import importlib.util
import json
import os
import time
import traceback
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..core.errors import FacemimeError, SourceError
from ..core.files.capture import VideoSource, read_image
from ..core.files.locks import lock_of, sweep
from ..core.files.pages import jpeg_of
from ..core.files.writing import check_writable, locked
from ..core.puppet.job import PuppetJob
from ..core.takes.file import SUFFIX, load_take
from ..core.takes.take import Take
from ..core.tracking.overlay import draw_frame
from .clips import CHECKSUMS, Checksums, Clip, Namer, find_clips, read_record, worst_frames, write_record
from .console import Progress, printable, say, tell
from .options import (
    Commands,
    add_command,
    add_output,
    add_preset_option,
    add_puppet_options,
    as_options,
    puppet_job,
    share_of_clips,
    whole_number,
)
from .puppet import run_puppet
from .report import Entry, Report, sheet_for_report
from .runners import DaskRunner, LocalRunner, Runner
from .stopping import INTERRUPTED

_SOURCES = "videos, folders, or text files with one path per line"
_OUTPUT = "output folder for each clip's .blend, .facetake, .png and record; clips that are done are skipped"
_THUMBNAIL = (240, 180)
_MAX_STATUS = 99


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    clip = add_command(
        commands,
        "clip",
        "process clips of a batch one after the other, unless they are done, and print a line of JSON for each; used "
        "by batch and render farms",
    )
    clip.add_argument("sources", nargs="+", type=Path, metavar="VIDEO|FOLDER|LIST", help=_SOURCES)
    which = clip.add_mutually_exclusive_group()
    which.add_argument("--number", type=whole_number, metavar="N", help="only this clip of a folder or list, from 1")
    which.add_argument(
        "--share", type=share_of_clips, metavar="N/M", help="only the N-th of M shares of the clips, such as 3/20"
    )
    add_output(clip, "DIR", _OUTPUT)
    add_preset_option(clip)
    add_puppet_options(clip)
    clip.set_defaults(
        run=lambda given: _run_clips(
            puppet_job(given, source=given["sources"][0]), _chosen(given["sources"], given["number"], given["share"])
        )
    )

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


def _run_clips(job: PuppetJob, clips: Sequence[Path]) -> int:
    """Run `facemime clip`: each clip to a head, a take, a sheet and a record; concurrent runs process it once.

    The output of the job is the output folder. Returns the exit status: that of a single clip, or the number of
    failures, at most 99.
    """
    folder = job.output
    check_writable(folder / CHECKSUMS)
    namer = Namer(job, Checksums(folder))
    failures = 0
    for path in clips:
        try:
            status, said = _run_clip(job, namer.clip(path)), ""
        except FacemimeError as error:
            status, said = 1, str(error)
            tell(f"facemime: {said}")
        except Exception:  # of one clip, which must not end the others
            status, said = 1, traceback.format_exc(limit=-1).strip()
            traceback.print_exc()
        if status == INTERRUPTED:
            return status
        say(json.dumps({"clip": os.fspath(path), "status": status, "said": said}))
        failures += status != 0
    return min(failures, _MAX_STATUS)


def _run_clip(job: PuppetJob, clip: Clip) -> int:
    """Process a clip, unless it is done; returns the exit status."""
    folder = job.output
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
        pictures = {str(number): picture for number, picture in enumerate(_thumbnails(clip.path, tracked), start=1)}
        pictures["sheet"] = sheet_for_report(read_image(sheet))
        write_record(clip, folder, tracked, time.monotonic() - started, pictures)
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
    named, entries = _named(clips, Namer(job, Checksums(folder)))
    unread = len(entries)
    entries += [_entry(clip, folder, before=True) for clip in named]
    todo = [number for number, entry in enumerate(entries) if entry.status == "not reached"]
    report = Report(entries, folder)
    progress = Progress("Puppeting", len(named), unit="clips")
    progress.update(before := len(named) - len(todo))
    interrupted, paths = False, [str(named[number - unread].path.absolute()) for number in todo]
    try:
        for ended, outcome in enumerate(runner.run(paths, ["-o", str(folder.absolute()), *as_options(job)]), start=1):
            number = todo[outcome.index]
            said = outcome.said or f"ended with status {outcome.status}"
            entries[number] = _entry(named[number - unread], folder, said=said)
            report.ended(number, entries[number])
            progress.update(before + ended)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        runner.close()
        progress.finish()
    # A clip may have been done just before the interruption: its record decides.
    for number in todo if interrupted else ():
        entry = _entry(named[number - unread], folder)
        if entries[number].status == "not reached" and entry.status == "done":
            entries[number] = entry
            report.ended(number, entry)
    failed = [entry for entry in entries if entry.status == "failed"]
    for entry in failed:
        last = (entry.said.splitlines() or ["no reason was given"])[-1]
        tell(f"facemime: {entry.clip}: {last.removeprefix('facemime: ')}")
    report.finish()
    tell(f"facemime: {len(failed)} of {len(entries)} clips failed; see {folder / 'report.html'}.")
    if interrupted:
        tell("facemime: interrupted. Run the same command again to continue.")
    return INTERRUPTED if interrupted else min(len(failed), _MAX_STATUS)


def _named(clips: Sequence[Path], namer: Namer) -> tuple[list[Clip], list[Entry]]:
    """The clips with their names, the same content once, and an entry for each clip that cannot be read."""
    named: dict[str, Clip] = {}
    failures: list[Entry] = []
    progress = Progress("Reading", len(clips), unit="clips")
    for number, path in enumerate(clips, start=1):
        progress.update(number)
        try:
            clip = namer.clip(path)
        except SourceError as error:
            failures.append(Entry(printable(path.name), "failed", said=printable(str(error))))
        else:
            named.setdefault(clip.name.rpartition("-")[2], clip)
    progress.finish()
    return list(named.values()), failures


def _entry(clip: Clip, folder: Path, *, before: bool = False, said: str = "") -> Entry:
    """The entry of a clip in the report before the batch, or after it was processed; its record decides."""
    name = printable(clip.path.name)
    if (record := read_record(clip, folder)) is not None:
        least = min(record["confidence"], default=1.0)
        return Entry(name, "skipped" if before else "done", clip.name, least=least)
    return Entry(name, "not reached" if before else "failed", clip.name, said)


def _chosen(sources: Sequence[Path], number: int | None, share: tuple[int, int] | None) -> list[Path]:
    """The clips of a task: a single one by its number, a share, or all."""
    clips = find_clips(sources)
    if share is not None:
        return clips[share[0] - 1 :: share[1]]
    if number is None:
        return clips
    if not 1 <= number <= len(clips):
        raise SourceError("There are {clips} clips. Choose one: --number 1 to --number {clips}.", clips=len(clips))
    return [clips[number - 1]]


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
