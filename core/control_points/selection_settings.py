"""Settings of the selection of control points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..face.landmarks import N_LANDMARKS
from ..files.setting import Choice, setting

Search = Literal["take", "paper"]


@dataclass(frozen=True)
class SelectionSettings:
    """How control points are selected for a take.

    Attributes
    ----------
    search : {"take", "paper"}
        "take" predicts landmarks by distance and by how they moved in the take, and exchanges and drops points; "paper"
        predicts them by distance alone, with a Gaussian, and only adds points.
    tolerance : float
        Error allowed at the other landmarks, as a fraction of the face's width.
    """

    search: Search = setting(
        "take",
        "Search",
        "How the control points are selected",
        choices=(
            Choice("take", "Whole Take", "Other landmarks follow as they did in the take; points may be dropped"),
            Choice("paper", "Yao et al. 2019", "Other landmarks follow by distance alone, and points are only added"),
        ),
    )
    tolerance: float = setting(
        0.01,
        "Tolerance",
        "Error allowed at the other landmarks, relative to the width of the face",
        low=0.0001,
        high=1.0,
        soft_high=0.1,
        unit="percent",
    )
    max_points: int = setting(N_LANDMARKS, "Max Points", "Maximum number of control points", low=3, high=N_LANDMARKS)
