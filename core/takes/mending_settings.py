"""Settings of the mending of takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..files.setting import Choice, setting

Gaps = Literal["leave", "bridge", "hold"]
Smoothing = Literal["none", "one-euro", "zero-phase"]


@dataclass(frozen=True)
class Mending:
    """Steps of mending, applied in the order of the fields.

    Attributes
    ----------
    gaps : {"leave", "bridge", "hold"}
        What to do with gaps without a face, as for `bridge_gaps`.
    longest : float
        Longest gap to fill in seconds.
    smoothing : {"none", "one-euro", "zero-phase"}
        No smoothing, smoothing as live, or smoothing without delay.
    cutoffs : mapping of str to float
        Cutoffs in Hz by part for "zero-phase", overriding `smooth.CUTOFFS`.
    mirror : bool
        Whether to swap left and right.
    neutral : float, optional
        Time of the new neutral face in seconds.
    """

    outliers: bool = setting(False, "Remove Outliers", "Remove frames that differ abruptly from their neighbours")
    gaps: Gaps = setting(
        "leave",
        "Gaps",
        "What to do with gaps without a face",
        choices=(
            Choice("leave", "Leave", "Leave gaps as they are"),
            Choice("bridge", "Interpolate", "Interpolate between the frames on both sides"),
            Choice("hold", "Hold", "Repeat the last frame with a face"),
        ),
    )
    longest: float = setting(
        1.0, "Longest Gap", "Longest gap to fill", low=0.0, high=3600.0, soft_high=10.0, unit="seconds"
    )
    smoothing: Smoothing = setting(
        "none",
        "Smooth",
        "How the motion is smoothed",
        choices=(
            Choice("none", "None", "Leave the motion as it is"),
            Choice("one-euro", "As Live", "Smooth as a live puppet does, with some lag"),
            Choice("zero-phase", "Without Delay", "Smooth forwards and backwards, without lag"),
        ),
    )
    cutoffs: Mapping[str, float] = field(default_factory=dict)
    mirror: bool = setting(False, "Mirror", "Swap left and right")
    neutral: float | None = None


REPAIR = Mending(outliers=True, gaps="bridge", smoothing="zero-phase")
"""What most takes need, offered by the panel."""
BLEND = 0.2
"""Seconds over which one take blends into another."""
