"""`python -m lab.training.sample` films the sample clip and writes its exact landmarks beside it.

The performer has a MakeHuman skin texture (CC0), which is visible in the clip but is not part of the repository.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..data import DATA, ROOT
from ..head.build import to_bytes
from ..head.source import open_source
from .actor import Actor, build_actor
from .performance import FPS, labels, place_at, pose_at, times, units_at

ASSETS = ROOT / "assets" / "sample"
SKIN = DATA / "heads/makehuman_skins/young_lightskinned_male_diffuse3.jpg"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m lab.training.sample", description=__doc__)
    parser.add_argument("--skin", type=Path, default=SKIN, help="MakeHuman skin picture")
    parser.add_argument("--samples", type=int, default=10, help="light paths a pixel")
    parser.add_argument("--stills", type=Path, help="only film a few moments, with landmarks drawn, into this folder")
    arguments = parser.parse_args()
    actor = build_actor(open_source(), arguments.skin)
    if arguments.stills:
        _film_stills(actor, arguments.skin, arguments.samples, arguments.stills)
    else:
        _film_clip(actor, arguments.skin, arguments.samples)
    return 0


def _moments(
    actor: Actor, clip: NDArray[np.float64]
) -> Iterator[tuple[NDArray[np.float64], list[NDArray[np.float64]]]]:
    for time in clip:
        yield actor.posed(units_at(time), pose_at(time), place_at(time))


def _film_clip(actor: Actor, skin: Path, samples: int) -> None:
    from facemime.blender.rendering import write_video

    from .stage import Stage, project

    clip = times()
    stage = Stage(actor, skin, samples)
    write_video(stage.film(_moments(actor, clip)), FPS, ASSETS / "sample.mp4")
    points = np.stack([project(base[actor.landmarks]) for base, _ in _moments(actor, clip)])
    truth = {
        "times": clip,
        "landmarks": points.astype(np.float32),
        "pose": np.stack([pose_at(time) for time in clip]).astype(np.float32),
        "labels": labels(),
    }
    (ASSETS / "sample_landmarks.npz").write_bytes(to_bytes(truth))


def _film_stills(actor: Actor, skin: Path, samples: int, folder: Path) -> None:
    from .stage import Stage, project

    clip = np.array([0.4, 1.64, 2.6, 3.5, 4.4, 5.28, 5.93, 6.94, 7.7, 8.55])
    stage = Stage(actor, skin, samples)
    folder.mkdir(parents=True, exist_ok=True)
    moments = list(_moments(actor, clip))
    for time, (base, _), image in zip(clip, moments, stage.film(iter(moments)), strict=True):
        cv2.imwrite(str(folder / f"{time:05.2f}.png"), image)
        for x, y in project(base[actor.landmarks]):
            cv2.circle(image, (round(x * 8), round(y * 8)), 12, (0, 255, 0), -1, cv2.LINE_AA, 3)
        cv2.imwrite(str(folder / f"{time:05.2f}-landmarks.png"), image)


if __name__ == "__main__":
    sys.exit(main())
