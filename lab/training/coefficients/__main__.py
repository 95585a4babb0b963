"""`python -m lab.training.coefficients` learns what the tracker shows of each of ARKit's coefficients.

It renders people who act random scripts, tracks them, adds simulated faces, and writes
assets/expressions/coefficients.npz. It uses the tracker, the neutral faces and the built-in head, which come first.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy loads: sums in another order give other bytes

import cv2
import numpy as np

from facemime.core.bake.arkit import Observer
from facemime.core.bake.coefficients import COEFFICIENT_FILE
from facemime.core.drive import retarget
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.takes.neutral import calmest
from facemime.core.tracking.tracker import FaceTracker

from ..data import ROOT, add_data_option
from ..patching import patched
from ..tracker.heads import IctHead, load_ict
from ..tracker.sources import HAND_LABELLED, read_photos, split
from .correction import learn_correction
from .learn import learn, model_bytes, shape_responses
from .performances import performer, tracked
from .simulate import Observed, built_in_face, ict_face, simulate

_SECONDS, _FPS = 24.0, 8.0
_FIRST = 1000
"""Number of the first performer. Those of the benchmark start at 0, so their scripts differ."""
_FACES, _EACH = 60, 120
"""Number of simulated faces of each family, and of observations of each face."""


def main() -> int:
    """Learn and write.

    Lips of rendered people are tracked as moving 0.8 to 0.98 times as far as they do, those of strangers 0.5 to 0.7
    times. The gain that makes up for it is not applied here, so that it is not learnt as part of the motion, nor is
    that of tilted brows, which was found in clips of strangers as well.
    """
    parser = argparse.ArgumentParser(prog="python -m lab.training.coefficients", description=__doc__)
    add_data_option(parser)
    parser.add_argument("--people", type=int, default=64)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    tracker, head, rng = FaceTracker.load(), load_ict(arguments.data), np.random.default_rng(5)
    families = [[built_in_face(rng) for _ in range(_FACES)], [ict_face(head, rng) for _ in range(_FACES)]]
    with patched({(retarget, "_LIP_GAIN"): (1.0, 1.0), (retarget, "_BROW_TILT"): 0.0}):
        built_in, ict = (simulate(faces, tracker.pdm, _EACH, rng) for faces in families)
        rendered = _rendered(arguments.data, arguments.people, tracker, head)
    model = learn(rendered, [built_in, ict], rng)
    restyling = shape_responses(built_in) - shape_responses(ict)
    content = model_bytes(replace(model, correction=learn_correction(model, rendered, restyling, rng)))
    COEFFICIENT_FILE.write_bytes(content)
    print(f"{COEFFICIENT_FILE.relative_to(ROOT)}: {len(content) / 1024:.0f} KB")
    return 0


def _rendered(data: Path, people: int, tracker: FaceTracker, head: IctHead) -> list[Observed]:
    photos = split(read_photos(data, *HAND_LABELLED))[0]
    takes = []
    for number, i in enumerate(np.linspace(0, len(photos) - 1, people).round().astype(int)):
        person = performer(head, tracker.pdm, photos[i], _FIRST + number)
        take, keys = tracked(tracker, person, _SECONDS, _FPS)
        # These performers rest at times, so their errors of the neutral face are what the model has to learn. With the
        # prior, which is for people who do not, it finds less of what was acted.
        observer = Observer(calmest(take, prior=False), DriveSettings())
        found = np.flatnonzero(take.found)
        takes.append(Observed(np.array([observer.face(take.result(int(row))) for row in found]), keys[found]))
        print(f"{number + 1}/{people}", end="\r", flush=True)
    return takes


if __name__ == "__main__":
    sys.exit(main())
