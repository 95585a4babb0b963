"""Settings of the tracker."""

from __future__ import annotations

from dataclasses import dataclass

from ..files.setting import Choice, setting

NETWORK, CASCADES = "network", "cascades"


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of the tracker.

    Attributes
    ----------
    detector : {"network", "cascades"}
        Detector for the first frame and after a loss; "cascades" is the paper's Viola-Jones detector.
    tracker_model : str
        File of a model of FaceTracker, whose linear experts the paper uses; "" is the shipped model.
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
    tracker_model: str = setting(
        "",
        "Tracker Model",
        "File of a model of FaceTracker, which the paper uses, from the next start on; empty for Facemime's own",
        unit="file",
    )


DEFAULTS = TrackingSettings()
