"""Differences of a face at rest from a neutral one (method.md, section 7.1)."""

from __future__ import annotations

import numpy as np

from ..errors import Message
from ..face.apertures import eye_apertures, mouth_aperture
from ..face.landmarks import MOUTH_CORNERS, from_ibug
from ..heads.checks import Finding
from ..numeric.arrays import FloatArray

_SHUT = 0.045
"""Aperture below which eyes count as shut: at most 0.03 to 0.04 on heads with shut eyes, 0.08 and more on others. All
lengths are in outer-eye distances."""
_OPEN = 0.05
"""Aperture above which the mouth counts as open."""
_USUAL_WIDTH = 0.56
"""Width of the mouth in the tracker's mean shape."""
_SMILE = 0.06
"""Rise of the corners of the mouth above its middle, plus half of its excess width, above which a face smiles: up to
0.04 on neutral heads, 0.1 and more on broad smiles."""


def resting_findings(shape: FloatArray) -> tuple[Finding, ...]:
    """Detect shut eyes, an open mouth and a smile in a face at rest.

    Parameters
    ----------
    shape : (66, 3) float64
        The tracker's landmarks without the pose: head frame, in outer-eye distances.

    Returns
    -------
    tuple of Finding
        The findings; empty for a neutral face.
    """
    findings = []
    if float(eye_apertures(shape).max()) < _SHUT:
        findings.append(
            Finding(
                Message("The eyes are shut at rest, so blinks would push the lids further."),
                Message("Open them in the mesh."),
            )
        )
    if float(mouth_aperture(shape)) > _OPEN:
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
