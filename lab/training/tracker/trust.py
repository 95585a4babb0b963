"""Trust in automatic labels, which are corrected to the hand labels' definition, and pruned by the shape model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from facemime.core.face.landmarks import INNER
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.tracking.pdm import PointDistributionModel

from .shape_model import definition_bias
from .sources import Photo

SMALLEST_EYE_DISTANCE = 28.0
LARGEST_RESIDUAL = 0.022


def trusted_photos(model: PointDistributionModel, photos: list[Photo], like: list[Photo] | None = None) -> list[Photo]:
    """Return the automatically labelled photos of one source that are large and plausible, with their bias removed.

    The tracker that made the labels places points systematically elsewhere than a person does (up to a tenth of the eye
    distance). That difference is estimated in the head's axes, from these photos or, if they show few people, from
    others that the same tracker labelled (`like`), and subtracted at each photo's pose.
    """
    large, measured = ([p for p in of if p.eye_distance() >= SMALLEST_EYE_DISTANCE] for of in (photos, like or photos))
    if not large or not measured:
        return []
    bias = definition_bias(model, measured)
    kept = []
    for photo in large:
        pose = model.fit(photo.landmarks, noise=0.02).pose
        corrected = photo.landmarks - pose[0] * bias @ euler_to_matrix(*pose[1:4])[:2].T
        fitted = model.fit(corrected, noise=0.02)
        left = np.linalg.norm(corrected - model.project(fitted.pose, fitted.shape_params), axis=1)[INNER].mean()
        if left < LARGEST_RESIDUAL * fitted.pose[0]:
            kept.append(replace(photo, landmarks=corrected))
    return kept
