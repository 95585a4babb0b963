"""Checks whether a head is ready to be driven, and differences of a face at rest from a neutral one (method.md, section
7.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import HeadError, Message
from ..face.landmarks import BROWS, IBUG68_INDICES, MOUTH_CORNERS, eye_apertures, from_ibug, mouth_aperture
from ..mesh.surface import SurfaceGraph
from ..numeric.arrays import FloatArray, IntArray
from .eyeballs import EYES, eye_outline
from .lids import eyes_joined
from .regions import REGIONS, membership, own_weights
from .slits import lips_joined

_MIN_WEIGHT = 0.01
_HELD = 0.95
"""Weight in its own regions that the vertex of a landmark needs in order to follow it."""
_MAX_LISTED = 8
_SHUT = 0.045
"""Aperture below which eyes count as shut: at most 0.03 to 0.04 on heads with shut eyes, 0.08 and more on others. All
lengths are in outer-eye distances."""
_OPEN = 0.05
"""Aperture above which the mouth counts as open."""
_PARTED = 0.035
"""Aperture of the lips of the mesh itself below which a mouth that looks open is not, as dark lips and shadows between
them look open: 0.023 on a mannequin with shut lips, 0.046 and more on the built-in head with a jaw that opens by a
tenth."""
_USUAL_WIDTH = 0.56
"""Width of the mouth in the tracker's mean shape."""
_SMILE = 0.06
"""Rise of the corners of the mouth above its middle, plus half of its excess width, above which a face smiles: up to
0.04 on neutral heads, 0.1 and more on broad smiles."""


_EYE_BROWS = BROWS[:5], BROWS[:4:-1]
"""Landmarks of the brows above `EYES`, the outer end first."""
_MIN_BROW_GAP = 0.05
"""Height of a brow above the upper lid: 0.15 or more on an anime figure, 0.44 or more on people. This limit and the
following ones are in eye widths, and leave a margin to what was found on heads that are bound correctly."""
_MIN_BROW_SHARE = 0.4
"""The same relative to the height of the lid above the corners: at least 0.7 on an anime figure, 1.7 on people."""
_MAX_LID_HEIGHT = 0.6
"""Distance of a lid above or below the corners: up to 0.32."""
_MAX_OVERLAP = 0.1
"""Distance of the lower lid above the upper one. Shut lids nearly coincide."""
_MAX_OVERHANG = 0.35
"""Distance of the upper lid in front of the lower one: up to 0.22. Lashes protrude further."""


@dataclass(frozen=True)
class Finding:
    """A problem of a head and its remedy, a sentence each, and the name of the step that remedies it, or ""."""

    problem: Message
    remedy: Message
    step: str = ""


HOLLOW = Finding(
    Message("Nothing is behind the lips, so the open mouth shows the inside of the head."),
    Message("Use Open Lips, which adds a dark pocket behind them, or model the inside of a mouth."),
    "open_lips",
)
"""The finding for lips with a border and nothing behind it, which other parts of the head decide."""


def check_head(vertices: FloatArray, faces: IntArray, landmarks: IntArray, region_weights: FloatArray) -> list[Finding]:
    """Return what would keep a head, with arrays as in `HeadRig`, from being driven well; nothing if it is ready."""
    findings = []
    unique, counts = np.unique(landmarks, return_counts=True)
    if (counts > 1).any():
        twins = np.flatnonzero(np.isin(landmarks, unique[counts > 1]))
        findings.append(
            Finding(
                Message("Landmarks {twins} share vertices.", twins=_list(twins)),
                Message("Move each to its own vertex."),
            )
        )
    findings += _region_findings(landmarks, region_weights)
    findings += _lip_findings(vertices, faces, landmarks)
    findings += _eye_findings(vertices, faces, landmarks)
    return findings


def _region_findings(landmarks: IntArray, region_weights: FloatArray) -> list[Finding]:
    findings = []
    weights = np.asarray(region_weights)[:, landmarks]
    outside = np.flatnonzero(weights.max(axis=0) < _MIN_WEIGHT)
    if len(outside):
        findings.append(
            Finding(
                Message("Landmarks {outside} lie in no region.", outside=_list(outside)),
                Message("Paint their regions over them, or find the face again."),
            )
        )
    partly = np.setdiff1d(np.flatnonzero(own_weights(region_weights, landmarks) < _HELD), outside)
    if len(partly):
        findings.append(
            Finding(
                Message("Landmarks {partly} are moved only partly by their regions.", partly=_list(partly)),
                Message("Paint these regions over them in full, or use Reset Regions."),
            )
        )
    for region, members, row, whole in zip(REGIONS, membership(), weights, region_weights, strict=True):
        if not np.asarray(whole).any():
            findings.append(
                Finding(
                    Message("The region {name} is empty.", name=region.name), Message("Paint it, or use Reset Regions.")
                )
            )
        elif not (members & (row >= _MIN_WEIGHT)).any():
            findings.append(
                Finding(
                    Message("The region {name} contains none of its control points.", name=region.name),
                    Message("Paint it over its landmarks, or use Reset Regions."),
                )
            )
    return findings


def _lip_findings(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> list[Finding]:
    if not lips_joined(SurfaceGraph(vertices, faces), landmarks):
        return []
    return [
        Finding(
            Message("The lips are joined, so the mouth cannot open."),
            Message("Use Open Lips, which cuts the mesh between them, or model a slit."),
            "open_lips",
        )
    ]


def _eye_findings(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> list[Finding]:
    if any(_misplaced(vertices, landmarks, eye, brow) for eye, brow in zip(EYES, _EYE_BROWS, strict=True)):
        # Whether such eyes are joined is unknown; a cut along these landmarks would be misplaced, too.
        return [
            Finding(
                Message("The landmarks of the lids seem to lie on a brow or on lashes."),
                Message("Mark the corners of the eyes, and find the face again."),
            )
        ]
    if not any(eyes_joined(vertices, faces, landmarks)):
        return []
    return [
        Finding(
            Message("The eyes are joined to their lids, so they cannot shut."),
            Message("Use Open Eyes, which cuts the mesh along the lids, or model separate eyes."),
            "open_eyes",
        )
    ]


def _misplaced(vertices: FloatArray, landmarks: IntArray, eye: IntArray, brow: IntArray) -> bool:
    """Return whether the landmarks of an eye do not look like lids below a brow."""
    try:
        outline = eye_outline(vertices, landmarks, eye)
    except HeadError:
        return True
    points = np.asarray(vertices, dtype=np.float64)[landmarks]
    upper, lower, line = (outline.to_local(points[part]) for part in (eye[[1, 2]], eye[[5, 4]], brow))
    line = line[np.argsort(line[:, 0])]
    brow_gap = np.interp(upper[:, 0], line[:, 0], line[:, 1]) - upper[:, 1]
    between = upper - lower
    return bool(
        (brow_gap < np.maximum(_MIN_BROW_GAP, _MIN_BROW_SHARE * upper[:, 1])).any()
        or max(upper[:, 1].max(), -lower[:, 1].min()) > _MAX_LID_HEIGHT
        or between[:, 1].min() < -_MAX_OVERLAP
        or between[:, 2].mean() > _MAX_OVERHANG
    )


def _list(landmarks: IntArray) -> str:
    numbers = [str(int(IBUG68_INDICES[i])) for i in landmarks]
    return ", ".join(numbers[:_MAX_LISTED]) + (
        f" and {len(numbers) - _MAX_LISTED} more" if len(numbers) > _MAX_LISTED else ""
    )


EYES_SHUT = Finding(
    Message("The eyes are shut at rest, so blinks would push the lids further."), Message("Open them in the mesh.")
)


def resting_findings(shape: FloatArray, places: FloatArray | None = None) -> tuple[Finding, ...]:
    """Detect shut eyes, an open mouth and a smile in the tracker's landmarks of a face at rest.

    These are (66, 3), without the pose: head frame, in outer-eye distances. So are the `places` of the landmarks on the
    mesh, whose lips decide whether its mouth is open. A neutral face has no findings.
    """
    findings = []
    if float(eye_apertures(shape).max()) < _SHUT:
        findings.append(EYES_SHUT)
    if float(mouth_aperture(shape)) > _OPEN and (places is None or float(mouth_aperture(places)) > _PARTED):
        findings.append(
            Finding(Message("The mouth is open at rest, so it would never close."), Message("Close it in the mesh."))
        )
    elif _smile(shape) > _SMILE:
        findings.append(
            Finding(
                Message("The face smiles at rest, so it would always smile."), Message("Make it neutral in the mesh.")
            )
        )
    return tuple(findings)


def _smile(shape: FloatArray) -> float:
    right, left = shape[MOUTH_CORNERS]
    rise = shape[from_ibug((51, 57)), 1].mean() - shape[MOUTH_CORNERS, 1].mean()
    return float(rise + 0.5 * (np.linalg.norm(right - left) - _USUAL_WIDTH))
