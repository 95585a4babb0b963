"""Milliseconds per stage, and frames per second from a video to the mesh in Blender, on one core.

Run as `python -m lab.bench.pipeline [VIDEO]`; the sample clip by default.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import bpy
import cv2
import numpy as np

from facemime.blender.animation.live import LiveHeadObject
from facemime.blender.animation.targets import own_targets
from facemime.blender.heads.new_heads import add_head
from facemime.blender.rigs import read_rig
from facemime.core.bake.arkit import FrameCoefficients
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.files.capture import VideoSource
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.report import Table, bars, finish, parser

ROOT = Path(__file__).resolve().parents[2]
STAGES = {
    "decode": "decode",
    "detect": "detect, first frame",
    "track": "track, frame to frame",
    "drive": "drive, 1,781 vertices",
    "write": "write to the shape key",
    "coefficients": "ARKit's coefficients",
}


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("video", type=Path, nargs="?", default=ROOT / "assets" / "sample" / "sample.mp4")
    arguments = command.parse_args()
    cv2.setNumThreads(1)
    times, frames, elapsed = measure(arguments.video)
    milliseconds = {name: 1e3 * np.array(times[name]) for name in STAGES}
    rows = [
        (title, *(float(np.percentile(milliseconds[name], p)) for p in (50, 95)), len(milliseconds[name]))
        for name, title in STAGES.items()
    ]
    fps = frames / elapsed
    tables = [
        Table("Milliseconds per stage, one core", ("stage", "median", "95th percentile", "samples"), rows),
        Table("End to end", ("frames", "seconds", "frames per second"), [(frames, elapsed, fps)]),
    ]
    numbers = {
        "milliseconds": {name: float(np.median(values)) for name, values in milliseconds.items()},
        "p95": {name: float(np.percentile(values, 95)) for name, values in milliseconds.items()},
        "fps": fps,
        "frames": frames,
    }
    if arguments.figure is not None:
        medians = list(numbers["milliseconds"].values())
        bars(arguments.figure, "From video frame to mesh, one core", list(STAGES.values()), medians, "ms")
    finish(arguments, tables, numbers)
    return 0


def measure(
    video: Path, options: DriveSettings | None = None, clock: Callable[[], float] = perf_counter
) -> tuple[dict[str, list[float]], int, float]:
    """Seconds of each stage and frame, the number of frames, and seconds in total.

    A frame is driven and written as by a live puppet, without its drawing. Coefficients, which a stream sends and a
    character's keys need, are found separately.
    """
    options = options or DriveSettings()
    tracker = FaceTracker.load()
    take = track_video(video, tracker)
    neutral = calibrate(take)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    head = add_head(bpy.context)
    driver = HeadDriver(read_rig(head), neutral, options)
    shown = LiveHeadObject(head, own_targets(head))
    shown.attach()
    times: dict[str, list[float]] = defaultdict(list)
    frames = 0
    with VideoSource(video) as source:
        for frame in source:
            if frame.index % 10 == 0:
                tracker.locate(frame.image)
                times["detect"].append(tracker.timings["detect"])
    found = FrameCoefficients(neutral, options)
    for index in np.flatnonzero(take.found).tolist():
        result, began = take.result(index), clock()
        found.of(result)
        times["coefficients"].append(clock() - began)
    tracker.reset()
    begin = last = clock()

    def lap(name: str) -> None:
        nonlocal last
        now = clock()
        times[name].append(now - last)
        last = now

    with VideoSource(video) as source:
        for frame in source:
            lap("decode")
            result = tracker.track(frame.image)
            if frame.index > 0:
                lap("track")
            if result.found:
                last = clock()
                moved = driver.frame(result)
                flat = shown.prepare(moved)
                lap("drive")
                shown.write(moved, flat)
                bpy.context.view_layer.update()
                lap("write")
            frames += 1
            last = clock()
    return times, frames, clock() - begin


if __name__ == "__main__":
    sys.exit(main())
