"""Facemime: live face puppetry for Blender.

Blender registers this package as an extension. In Python, it is a library, which does not need Blender:

>>> from facemime import HeadDriver, built_in_head, calibrate, track_video
>>> take = track_video("clip.mp4")
>>> driver = HeadDriver(built_in_head(), calibrate(take))
>>> driver.frame(take.result(0)).vertices.shape
(1781, 3)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .core.bake.arkit import arkit_coefficients as arkit_coefficients
    from .core.bake.curves import fit_key_curves as fit_key_curves
    from .core.bake.fit import fit_basis as fit_basis
    from .core.bake.fit import fit_keys as fit_keys
    from .core.control_points.select import select_control_points as select_control_points
    from .core.deform.head_deformer import head_deformer as head_deformer
    from .core.deform.rbf import RBFDeformer as RBFDeformer
    from .core.drive.drive_settings import DriveSettings as DriveSettings
    from .core.drive.driver import HeadDriver as HeadDriver
    from .core.drive.driver import HeadFrame as HeadFrame
    from .core.errors import FacemimeError as FacemimeError
    from .core.face.names import COEFFICIENTS as COEFFICIENTS
    from .core.heads.bind import bind_head as bind_head
    from .core.heads.key_map import KeyMap as KeyMap
    from .core.heads.key_map import KeyRow as KeyRow
    from .core.heads.regions import REGIONS as REGIONS
    from .core.heads.rig import HeadRig as HeadRig
    from .core.heads.rig import built_in_head as built_in_head
    from .core.takes.file import load_take as load_take
    from .core.takes.file import save_take as save_take
    from .core.takes.from_video import track_video as track_video
    from .core.takes.neutral import Neutral as Neutral
    from .core.takes.neutral import calibrate as calibrate
    from .core.takes.smooth import smooth_take as smooth_take
    from .core.takes.take import Take as Take
    from .core.tracking.result import TrackResult as TrackResult
    from .core.tracking.tracker import FaceTracker as FaceTracker

_PLACES = {
    "COEFFICIENTS": "face.names",
    "DriveSettings": "drive.drive_settings",
    "FaceTracker": "tracking.tracker",
    "FacemimeError": "errors",
    "HeadDriver": "drive.driver",
    "HeadFrame": "drive.driver",
    "HeadRig": "heads.rig",
    "KeyMap": "heads.key_map",
    "KeyRow": "heads.key_map",
    "Neutral": "takes.neutral",
    "RBFDeformer": "deform.rbf",
    "REGIONS": "heads.regions",
    "Take": "takes.take",
    "TrackResult": "tracking.result",
    "arkit_coefficients": "bake.arkit",
    "bind_head": "heads.bind",
    "built_in_head": "heads.rig",
    "calibrate": "takes.neutral",
    "fit_basis": "bake.fit",
    "fit_key_curves": "bake.curves",
    "fit_keys": "bake.fit",
    "head_deformer": "deform.head_deformer",
    "load_take": "takes.file",
    "save_take": "takes.file",
    "select_control_points": "control_points.select",
    "smooth_take": "takes.smooth",
    "track_video": "takes.from_video",
}
"""Modules of `core` from which names are loaded when they are first used, as enabling the extension must not wait."""

__all__ = list(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")  # noqa: EM102 - as Python says it
    value = getattr(import_module(f".core.{_PLACES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def register() -> None:
    """Register the extension; RuntimeError if this Windows lacks a part that OpenCV needs."""
    from .core.puppet.windows_cameras import missing_media_foundation

    if missing := missing_media_foundation():
        raise RuntimeError(missing)
    from . import registration

    registration.register()


def unregister() -> None:
    """Unregister the extension."""
    from . import registration

    registration.unregister()
