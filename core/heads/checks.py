"""Checks whether a head is ready to be driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..landmarks import IBUG68_INDICES
from ..mesh.surface import SurfaceGraph, lips_joined
from .lids import eyes_joined
from .regions import REGIONS, membership, own_weights

_MIN_WEIGHT = 0.01
_HELD = 0.95
"""Weight in its own regions that the vertex of a landmark needs in order to follow it."""
_MAX_LISTED = 8


@dataclass(frozen=True)
class Finding:
    """A problem of a head and its remedy.

    Attributes
    ----------
    problem, remedy : str
        A sentence each.
    step : str
        Name of the step that remedies the problem; "" if there is none.
    """

    problem: str
    remedy: str
    step: str = ""


def check_head(vertices: FloatArray, faces: IntArray, landmarks: IntArray, region_weights: FloatArray) -> list[Finding]:
    """Check a head for problems that would keep it from being driven well.


    Parameters
    ----------
    vertices, faces, landmarks, region_weights : (V, 3), (F, K), (66,), (3, V) array
        As in `HeadRig`.

    Returns
    -------
    list of Finding
        A finding per problem; empty if the head is ready.
    """
    findings = []
    unique, counts = np.unique(landmarks, return_counts=True)
    if (counts > 1).any():
        twins = np.flatnonzero(np.isin(landmarks, unique[counts > 1]))
        findings.append(Finding(f"Landmarks {_list(twins)} share vertices.", "Bind each to its own vertex."))
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
                f"Landmarks {_list(outside)} lie in no region.", "Paint their regions over them, or bind them again."
            )
        )
    partly = np.setdiff1d(np.flatnonzero(own_weights(region_weights, landmarks) < _HELD), outside)
    if len(partly):
        findings.append(
            Finding(
                f"Landmarks {_list(partly)} are moved only partly by their regions.",
                "Paint these regions over them in full, or propose the regions again.",
            )
        )
    for region, members, row, whole in zip(REGIONS, membership(), weights, region_weights, strict=True):
        if not np.asarray(whole).any():
            findings.append(Finding(f"The region {region.name} is empty.", "Paint it, or propose the regions again."))
        elif not (members & (row >= _MIN_WEIGHT)).any():
            findings.append(
                Finding(
                    f"The region {region.name} contains none of its control points.",
                    "Paint it over its landmarks, or propose the regions again.",
                )
            )
    return findings


def _lip_findings(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> list[Finding]:
    if not lips_joined(SurfaceGraph(vertices, faces), landmarks):
        return []
    return [
        Finding(
            "The lips are joined, so the mouth cannot open.",
            "Use Open Lips, which cuts the mesh between them, or model a slit.",
            "open_lips",
        )
    ]


def _eye_findings(vertices: FloatArray, faces: IntArray, landmarks: IntArray) -> list[Finding]:
    if not any(eyes_joined(vertices, faces, landmarks)):
        return []
    return [
        Finding(
            "The eyes are joined to their lids, so they cannot shut.",
            "Use Open Eyes, which cuts the mesh along the lids, or model separate eyes.",
            "open_eyes",
        )
    ]


def _list(landmarks: IntArray) -> str:
    numbers = [str(int(IBUG68_INDICES[i])) for i in landmarks]
    return ", ".join(numbers[:_MAX_LISTED]) + (
        f" and {len(numbers) - _MAX_LISTED} more" if len(numbers) > _MAX_LISTED else ""
    )
