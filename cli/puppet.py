"""The commands `track`, from a video to a take, and `puppet`, from either of these to an animated head."""

from __future__ import annotations

import os
from pathlib import Path

from ..core.files.capture import PICTURE_RATE, require_file, require_utf8_name
from ..core.files.writing import free_name, settle
from ..core.puppet.job import PuppetJob
from ..core.takes.file import SUFFIX, save_take
from ..core.takes.from_video import numbered
from ..core.takes.smooth import smooth_take
from ..core.takes.take import Take
from ..core.tracking.tracker import TrackingSettings
from .console import tell
from .job_files import (
    INTERRUPTED_NAME,
    growing,
    importing_blender,
    keep_interrupted,
    load_with_warnings,
    outputs_of,
    place_beside,
    track,
    track_everybody,
    unfinished_beside,
)
from .options import (
    Commands,
    Options,
    add_command,
    add_face_option,
    add_neutral_option,
    add_output,
    add_preset_option,
    add_puppet_options,
    add_settings,
    filled,
    number,
    puppet_job,
)


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    track = add_command(commands, "track", "track the face in a video")
    track.add_argument(
        "video",
        type=Path,
        metavar="VIDEO|FOLDER",
        help="any video that FFmpeg reads, such as MP4 (H.264), or a folder with its frames as pictures",
    )
    add_output(track, "TAKE.facetake", "the take, which can drive any head; written while tracking")
    track.add_argument("--smooth", action="store_true", help="reduce jitter")
    which = track.add_mutually_exclusive_group()
    add_face_option(which)
    which.add_argument(
        "--faces",
        choices=("one", "all"),
        default="one",
        help="write one take, or a numbered one of everybody in the video, such as TAKE-1.facetake (one)",
    )
    track.add_argument(
        "--rate",
        type=number,
        default=PICTURE_RATE,
        metavar="FPS",
        help=f"frames per second of pictures ({PICTURE_RATE:g})",
    )
    add_settings(track, TrackingSettings)
    track.set_defaults(run=_run_track)

    puppet = add_command(commands, "puppet", "animate a head from a video or a take")
    puppet.add_argument("source", type=Path, metavar="VIDEO|TAKE", help="a video, or a take from track")
    add_output(puppet, "OUT.blend", "the head with its animation")
    puppet.add_argument(
        "--preview", type=Path, metavar="OUT.mp4", help="also write a video of performer and avatar side by side"
    )
    puppet.add_argument(
        "--sheet", type=Path, metavar="OUT.png", help="also write a contact sheet of the most distinct expressions"
    )
    puppet.add_argument(
        "--gltf",
        type=Path,
        metavar="OUT.glb",
        help="also write the head and its animation for browsers and engines; --positive is then the default",
    )
    puppet.add_argument("--take", type=Path, metavar="TAKE.facetake", help="also write the take")
    add_neutral_option(puppet)
    add_preset_option(puppet)
    add_puppet_options(puppet)
    puppet.set_defaults(run=lambda given: run_puppet(puppet_job(given)), positive=None)


def _run_track(given: Options) -> int:
    """Run `facemime track`: write a video as a take, or as one of everybody; returns the exit status."""
    video, output, settings = given["video"], given["output"], filled(TrackingSettings, given)
    unfinished = unfinished_beside(output)
    with outputs_of(((output, {SUFFIX}),), {"the video that is tracked": video}, unfinished):
        if given["faces"] == "all":
            takes = track_everybody(video, unfinished, settings, given["rate"])
            return max(_finish(grown, numbered(output, i), take, given) for i, (grown, take) in enumerate(takes))
        with growing(unfinished) as unfinished:
            take = track(video, unfinished, given["face"], settings, given["rate"])
            return _finish(unfinished, output, take, given)


def _finish(unfinished: Path, output: Path, take: Take, given: Options) -> int:
    """Smooth a take if that was asked for, and give its file the name `output`; returns the exit status."""
    if given["smooth"]:
        take = smooth_take(take)
        save_take(take, unfinished)
    if take.info.get("interrupted"):
        return keep_interrupted(take, unfinished, place_beside(output, SUFFIX))
    settle(unfinished, output)
    if given["faces"] == "all":
        tell(f"{output}: a face in {int(take.found.sum())} of {len(take)} frames")
    return 0


def run_puppet(job: PuppetJob) -> int:
    """Run `facemime puppet`: animate a head, and write pictures of it; returns the exit status.

    Raises FacemimeError if Blender is missing, or anything in the job cannot be read, written or driven.
    """
    with importing_blender("puppet", "puppet ..."):
        from . import headless
    unfinished = unfinished_beside(job.take or job.output)
    with outputs_of(job.outputs, job.inputs, *([unfinished] if job.tracks else [])):
        for path, _ in job.outputs:
            if path is not None:
                require_utf8_name(Path(os.path.realpath(path)))
        if not os.path.exists(job.source):  # before a character is bound
            require_file(job.source)
        stage = headless.open_stage(job)
        if not job.tracks:
            take = load_with_warnings(job.source)
            if job.take is not None:
                save_take(take, job.take)
            headless.puppet(job, stage, take, None)
            return 0
        with growing(unfinished) as unfinished:
            take = track(job.source, unfinished, job.face, job.settings.tracking)
            if take.info.get("interrupted"):
                return keep_interrupted(take, unfinished, _part_of(job))
            if job.take is not None:
                settle(unfinished, job.take)
            headless.puppet(job, stage, take, job.source)
        unfinished.unlink(missing_ok=True)
    return 0


def _part_of(job: PuppetJob) -> Path:
    """File for the take of an interrupted job."""
    if job.take is not None:
        return place_beside(job.take, SUFFIX)
    return free_name(job.output.with_suffix(f"{INTERRUPTED_NAME}{SUFFIX}"))
