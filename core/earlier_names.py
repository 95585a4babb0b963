"""Modules of `core` under their names of version 0.1.0, for programs that import them, until 1.0."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_CORE = __name__.rpartition(".")[0]
_MOVED = {
    "actions": "face.actions",
    "apertures": "face.apertures",
    "archives": "files.archives",
    "arrays": "numeric.arrays",
    "assets": "files.assets",
    "bake.settings": "bake.bake_settings",
    "capture": "media.capture",
    "closing": "files.closing",
    "coefficient_names": "face.coefficient_names",
    "control_points.settings": "control_points.selection_settings",
    "drive.expression_keys": "keys.expression_keys",
    "drive.key_quality": "keys.key_quality",
    "drive.key_sets": "keys.key_sets",
    "drive.keyed_face": "keys.keyed_face",
    "drive.settings": "drive.drive_settings",
    "images": "media.images",
    "landmarks": "face.landmarks",
    "linalg": "numeric.linalg",
    "locks": "files.locks",
    "media_starts": "media.media_starts",
    "onnx": "numeric.onnx",
    "opencv": "numeric.opencv",
    "picture_size": "media.picture_size",
    "presets": "files.preset_files",
    "puppet.presets": "puppet.built_in_presets",
    "puppet.settings": "puppet.puppet_settings",
    "reading": "files.reading",
    "rotation": "face.rotation",
    "settings": "files.setting",
    "streams.addresses": "streams.transport.addresses",
    "streams.background": "streams.transport.background",
    "streams.datagram": "streams.transport.datagram",
    "streams.face_cap": "streams.protocols.face_cap",
    "streams.face_motion": "streams.protocols.face_motion",
    "streams.frames": "streams.protocols.frames",
    "streams.identity": "streams.transport.identity",
    "streams.ifacialmocap": "streams.protocols.ifacialmocap",
    "streams.live_link": "streams.protocols.live_link",
    "streams.openseeface": "streams.protocols.openseeface",
    "streams.osc": "streams.protocols.osc",
    "streams.pairing": "streams.transport.pairing",
    "streams.security": "streams.transport.security",
    "streams.sessions": "streams.transport.sessions",
    "streams.settings": "streams.stream_settings",
    "streams.tls_server": "streams.transport.tls_server",
    "streams.vmc": "streams.protocols.vmc",
    "streams.vrcfacetracking": "streams.protocols.vrcfacetracking",
    "streams.vtube_studio": "streams.protocols.vtube_studio",
    "takes.settings": "takes.mending_settings",
    "timecode": "takes.timecodes",
    "tracking.settings": "tracking.tracking_settings",
    "version": "files.assets",
    "viewer.settings": "viewer.viewer_settings",
}
"""Names below `core`: earlier ones, and those of today."""


class EarlierNames(MetaPathFinder, Loader):
    """Finds a module under its earlier name; it is the same module."""

    def __init__(self) -> None:
        self._specs: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module that has another name now."""
        return ModuleSpec(fullname, self) if fullname.removeprefix(f"{_CORE}.") in _MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import the module of today."""
        today = f"{_CORE}.{_MOVED[spec.name.removeprefix(f'{_CORE}.')]}"
        warnings.warn(f"{spec.name} is now {today}", DeprecationWarning, stacklevel=2)
        module = import_module(today)
        self._specs[today] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own specification back, which importing it under another name replaces."""
        module.__spec__ = self._specs.pop(module.__name__)


def install() -> None:
    """Let programs import modules under their earlier names."""
    sys.meta_path.append(EarlierNames())
