"""Identity and expression spaces at the landmarks: from hand-labelled neutral faces and ICT-FaceKit's shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from facemime.core.face.landmarks import MIRROR
from facemime.core.takes.face_space import FORMAT, FaceSpace, without_similarity
from facemime.core.tracking.pdm import PointDistributionModel

from ..head.build import to_bytes
from ..tracker.heads import load_ict
from ..tracker.sources import HAND_LABELLED, read_photos, split

_NOT_EXPRESSIONS = ("PupilDilate", "cheekRaiser", "eyeLook")
"""Shapes beyond ARKit's, and looks, which move lids too little to be distinguished from expressions."""
_MODES = 40
_OF_PHOTOS, _OF_ICT = 0.9, 0.5
"""Shares of the two families' deviations. Photos show real people, but few; ICT-FaceKit's heads span more
directions."""
_FLIP = np.array([-1.0, 1.0, 1.0])


def learn_face_space(data: Path, pdm: PointDistributionModel) -> FaceSpace:
    """Return the symmetric spaces of the people that the tracker may be trained on.

    Its shape model, `pdm`, gives the photos their depth; `data` is the folder of the training data.
    """
    head = load_ict(data)
    photos = split(read_photos(data, *HAND_LABELLED))[0]
    seen = np.stack([pdm.shape(pdm.fit(photo.landmarks, noise=0.01).shape_params) for photo in photos])
    seen = np.concatenate([seen, seen[:, MIRROR] * _FLIP])
    mean = seen.mean(axis=0)
    drawn = head.identity[:, head.landmarks].astype(np.float64)
    drawn = np.concatenate([drawn, drawn[:, MIRROR] * _FLIP])
    # Rows whose products are the covariances: samples of people, and modes of one standard deviation.
    rows = np.concatenate([_OF_PHOTOS * (seen - mean) / np.sqrt(len(seen)), _OF_ICT * drawn / np.sqrt(2.0)])
    flat = without_similarity(rows, mean).reshape(len(rows), -1)
    _, deviations, modes = np.linalg.svd(flat, full_matrices=False)
    identity = (deviations[:_MODES, None] * modes[:_MODES]).reshape(-1, *mean.shape)
    chosen = [i for i, name in enumerate(head.names) if not name.startswith(_NOT_EXPRESSIONS)]
    units = without_similarity(head.expression[chosen][:, head.landmarks].astype(np.float64), mean)
    return FaceSpace(mean, identity, units)


def face_space_bytes(space: FaceSpace) -> bytes:
    """Return the content of the file, with half floats; signs of the modes are fixed, so that it is reproducible."""
    largest = np.abs(space.identity).reshape(len(space.identity), -1).argmax(axis=1)
    signs = np.sign(space.identity.reshape(len(space.identity), -1)[np.arange(len(largest)), largest])
    return to_bytes(
        {
            "format": np.array(FORMAT),
            "mean": space.mean.astype(np.float32),
            "identity": (space.identity * signs[:, None, None]).astype(np.float16),
            "units": space.units.astype(np.float16),
        }
    )
