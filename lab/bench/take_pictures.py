"""Pictures of a real clip, punched in, smoothed, baked in three ways and rendered: `python -m lab.bench.take_pictures`.

They are written to `takes_bakes.jpg` and `takes_mended.jpg` in `docs/images`. The retake is an earlier part of the
clip.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import bpy
import cv2
import numpy as np
from numpy.typing import NDArray

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.new_heads import add_head
from facemime.blender.preview_scene import setup_preview
from facemime.blender.rendering import render_frames, set_rate
from facemime.blender.timeline import frames_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.files.capture import VideoSource
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.from_video import track_video
from facemime.core.takes.mending import draw_before_after
from facemime.core.takes.smooth import smooth_zero_phase
from facemime.core.takes.take import Take
from facemime.core.takes.timing import punch_in, shift_time, trim
from facemime.core.tracking.overlay import draw_face, draw_label
from facemime.core.tracking.tracker import FaceTracker

ROOT = Path(__file__).resolve().parents[2]
CLIP = ROOT / "assets" / "sample" / "sample.mp4"
START, END, EARLIER = 6.0, 8.0, 4.0
MOMENTS = (1.7, 2.6, 4.4, 5.3, 6.6, 8.6)
SIDE, QUALITY = 240, 82
MODES = {"new keys": "new", "ARKit's keys": "named", "Mesh Cache": "cache"}

Image = NDArray[np.uint8]


def main() -> int:
    """Write both pictures; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "images", metavar="DIR")
    folder = parser.parse_args().output
    take = track_video(CLIP, FaceTracker.load())
    retake = shift_time(trim(take, START - EARLIER, END - EARLIER), EARLIER)
    punched = punch_in(take, retake, START, END, blend=0.3)
    mended = smooth_zero_phase(punched)
    rows = np.searchsorted(mended.times, MOMENTS)
    sheet = [_performer(take, mended, rows)]
    for name, keys in MODES.items():
        pictures, summary = _baked(mended, keys, mended.times[rows])
        sheet.append(np.hstack([draw_label(pictures[0], name), *pictures[1:]]))
        print(f"{name}: {summary}")
    _write(folder / "takes_bakes.jpg", np.vstack(sheet))
    _write(folder / "takes_mended.jpg", draw_before_after(take, mended))
    return 0


def _performer(take: Take, mended: Take, rows: NDArray[np.intp]) -> Image:
    """Frames of the camera at `rows` of the mended take; in the punched-in part, those of the retake."""
    times = mended.times[rows]
    times = np.where((times > START) & (times < END), times - EARLIER, times)
    wanted = [int(np.abs(take.times - time).argmin()) for time in times]
    seen = {}
    with VideoSource(CLIP) as source:
        for frame in source:
            if frame.index in wanted:
                seen[frame.index] = draw_face(frame.image, take.landmarks[frame.index].astype(float), SIDE)
    return np.hstack([draw_label(seen[n], f"{time:.1f} s") for n, time in zip(wanted, mended.times[rows], strict=True)])


def _baked(take: Take, keys: str, times: NDArray[np.float64]) -> tuple[list[Image], str]:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    set_rate(scene, float(take.info["fps"]))
    head = add_head(bpy.context, units=keys == "named")
    with tempfile.TemporaryDirectory() as folder:
        bake = BakeSettings(keys=keys, path=Path(folder) / "take.pc2")
        report = puppet_head(scene, head, take, PuppetSettings(bake=bake))
        setup_preview(scene, head, (SIDE, SIDE))
        return list(render_frames(scene, frames_of(scene, times), (SIDE, SIDE))), report.summary()


def _write(path: Path, picture: Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), picture, (cv2.IMWRITE_JPEG_QUALITY, QUALITY))
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
