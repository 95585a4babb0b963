"""Settings of face detection."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.setting import Choice, setting

NETWORK, CASCADES = "network", "cascades"


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of face detection.

    Attributes
    ----------
    detector : {"network", "cascades"}
        Detector for the first frame and after a loss; "cascades" is the paper's Viola-Jones detector.
    """

    detector: str = setting(
        NETWORK,
        "Face Detector",
        "How faces are found on the first frame and after tracking was lost",
        choices=(
            Choice(NETWORK, "Neural Network", "Find faces from any angle, with Viola-Jones for those that are missed"),
            Choice(CASCADES, "Viola-Jones", "Find faces with cascades alone, as in the paper"),
        ),
    )


DEFAULTS = TrackingSettings()
