"""What the tracker is trained with: parts of the face, numbers of images and steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facemime.core.face.names import ACTIONS, action_indices
from facemime.core.tracking.gaze import EYES

from .crops import ActionPart
from .sources import CLIPS

SEED = 2019
PATCH_SCALE = 72.0
"""Pixels per outer-eye distance of the patch experts."""
FRONTAL_BELOW, SIDE_ABOVE = 0.5, 0.22
"""Yaw in radians up to which and from which the views' training images extend; those in between are used for both."""
N_CLUTTER = 1500
BATCH = {"face": 64, "glance": 96, "eye": 96, "mouth": 96}
STEPS = {"face": 7000, "glance": 4000, "eye": 6000, "mouth": 6000}
FURTHER_STEPS = 3000
"""Steps by which the network of a part that ships is trained further."""
FURTHER_RATE = 5e-4
"""Highest rate of these steps, a sixth of that from the beginning."""
VARIANCE = {"face": 0.6, "glance": 0.3, "eye": 0.5, "mouth": 0.5}
"""Variance of the desired maps in cells."""
FACES = {"face": (36.0, 96, 0.4), "glance": (20.0, 48, 0.15)}
"""Pixels per outer-eye distance, side of the image, and share of images at poses as wrong as a detector's. The second
network sees a face where it was a frame ago, at a quarter of the cost."""
PARTS = {
    "eye": (np.r_[17:22, 36:42], 60.0, (48, 40), True),
    "mouth": (np.r_[31:36, 48:66], 44.0, (40, 48), False),
}
"""Landmarks, pixels per outer-eye distance, size of the image, and whether the other half of the face has the part,
too."""
_UPPER = ("browInnerUpRight", "browDownRight", "noseSneerRight", "cheekSquintRight")
_LOWER = [name for name in ACTIONS if name.startswith(("tongue", "mouth", "cheekPuff"))]
ACTION_PARTS = {
    "eye": ActionPart(action_indices(_UPPER), np.array([31, 36, 39]), 48.0, (48, 56), True),
    "mouth": ActionPart(action_indices(_LOWER), np.array([48, 54, 57]), 44.0, (64, 56), False),
}
"""The image of the eye extends from above the brow to the wing of the nose, that of the mouth over both cheeks."""
ACTION_BATCH, ACTION_STEPS = 64, 30_000
PUPIL_PART = (EYES, 60.0, (80, 24), False)
"""A band with both eyes, as `PARTS`."""
PUPIL_BATCH, PUPIL_STEPS = 96, 7000


@dataclass(frozen=True)
class Recipe:
    """Number of training images per photo of a source, and trust in its labels.

    `renders` show any expression, `speaking` ones a mouth that speaks, `copies` are the photo itself, degraded.
    """

    renders: int
    speaking: int
    copies: int
    weight: float


RECIPES = {
    "london_neutral": Recipe(50, 40, 36, 1.0),
    "canada": Recipe(50, 40, 36, 1.0),
    "london_smiling": Recipe(12, 10, 24, 0.6),
    "congress": Recipe(8, 6, 16, 0.3),
    CLIPS: Recipe(0, 0, 4, 0.2),
}
ACTING = {"london_neutral": 96, "canada": 96, "congress": 8}
"""Number of renders of a photo for the expert of actions, and of a held-out photo, the first of which show a face at
rest."""
HELD_OUT_ACTING, RESTING = 60, 10
LOOKING = {"london_neutral": 60, "canada": 60, "london_smiling": 10, "congress": 7}
"""Number of renders of a photo for the experts of the pupils."""
SCENE_HEADS_BY_HAND, SCENE_HEADS = 24, 4
"""Number of renders for the face detector per photo labelled by hand, and per other photo."""
DETECTOR_BATCH, DETECTOR_STEPS = 48, 9000
RENDERS_PER_SKIN = 24
"""Number of renders of a photo before it is decided again whether to mirror it."""
