"""Modules of a package under their names of version 0.1.0, for programs that import them, until 2.0."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

PACKAGES = {
    "binding": "heads",
    "live": "puppet",
    "recordings": "takes",
}
"""Names of packages below `core`: earlier ones, and those that have their modules today."""
MODULES = {
    "bake.arkit": "bake.observation",
    "bake.bake_settings": "bake.settings",
    "bake.bezier": "bake.segments",
    "bake.coefficients": "bake.coefficient_model",
    "bake.expression_keys": "bake.refine drive.expression_keys",
    "bake.key_quality": "drive.key_quality drive.keyed_face",
    "bake.key_sets": "drive.key_sets",
    "bake.fit": "bake.basis bake.clean",
    "files.archives": "archives",
    "numeric.arrays": "arrays",
    "files.assets": "assets version",
    "files.capture": "capture images",
    "files.closing": "closing",
    "face.landmarks": "apertures landmarks",
    "numeric.least_squares": "bake.least_squares",
    "numeric.linalg": "linalg mesh.sparse",
    "files.locks": "locks",
    "files.media_headers": "media_starts picture_size",
    "face.names": "actions bake.key_names coefficient_names",
    "numeric.opencv": "onnx opencv",
    "files.reading": "reading",
    "face.rotation": "rotation",
    "files.setting": "settings",
    "drive.actions": "deform.action_modes",
    "deform.covariance": "deform.follow deform.skin",
    "drive.driver": "drive.motion",
    "drive.drive_settings": "drive.settings",
    "drive.parts": "deform.glue",
    "drive.posing": "drive.eyes drive.jaw",
    "drive.retarget": "drive.anonymous",
    "control_points.selection": "control_points.selection_settings control_points.settings",
    "heads.bind": "binding.head",
    "heads.built_in": "heads.looks",
    "heads.character_files": "heads.vrm takes.file_rate",
    "heads.checks": "binding.rest",
    "heads.eyeballs": "heads.eye_outline",
    "heads.fit_template": "binding.fit",
    "mesh.kernels": "mesh.warp",
    "heads.key_map": "bake.key_map",
    "heads.part_names": "heads.bones",
    "heads.portrait": "binding.eye_contours",
    "heads.regions": "heads.region_edit",
    "heads.rig": "heads.parts",
    "heads.symmetry": "rigs.symmetry",
    "heads.slits": "heads.lips",
    "mesh.surface": "mesh.nearest mesh.pieces",
    "heads.template": "binding.align",
    "mesh.triangles": "mesh.intersections mesh.raster",
    "puppet.outputs": "live.head_drivers live.key_driver",
    "puppet.performer": "live.calibration puppet.performance",
    "puppet.presets": "presets",
    "puppet.puppet_settings": "puppet.settings",
    "rigs.display": "rigs.arrows rigs.sheet",
    "streams.transport.addresses": "streams.addresses streams.pairing",
    "streams.transport.datagram": "streams.datagram streams.sessions",
    "streams.diagnosis": "streams.incoming",
    "streams.phone": "streams.phone_link",
    "streams.playout": "streams.timeline",
    "streams.transport.security": "streams.security streams.identity",
    "streams.stream_settings": "streams.settings",
    "streams.protocols.face_cap": "streams.face_cap",
    "streams.protocols.face_motion": "streams.face_motion",
    "streams.protocols.frames": "streams.frames",
    "streams.protocols.ifacialmocap": "streams.ifacialmocap",
    "streams.protocols.live_link": "streams.live_link",
    "streams.protocols.openseeface": "streams.openseeface",
    "streams.protocols.osc": "streams.osc",
    "streams.protocols.vmc": "streams.vmc",
    "streams.protocols.vrcfacetracking": "streams.vrcfacetracking",
    "streams.protocols.vtube_studio": "streams.vtube_studio",
    "streams.transport.background": "streams.background",
    "streams.transport.tls_server": "streams.tls_server",
    "streams.vertices": "streams.vertex_decoder",
    "takes.curves": "takes.coefficient_take",
    "takes.measured": "takes.from_animation takes.from_coefficients",
    "takes.mending": "takes.figure takes.mending_settings takes.settings",
    "takes.pin_editor": "takes.doubt",
    "takes.recordings": "recordings.other_programs recordings.reading recordings.unity_clip",
    "takes.table_angles": "takes.live_link_angles",
    "takes.table_times": "takes.timecodes timecode",
    "takes.timing": "takes.between",
    "tracking.identity": "tracking.choice",
    "tracking.network": "tracking.check tracking.network_detector",
    "tracking.people": "puppet.roles",
    "tracking.patch_experts": "tracking.action_experts",
    "tracking.result": "tracking.hidden_mouth tracking.mirror",
    "tracking.tracker": "tracking.settings tracking.tracking_settings",
    "viewer.messages": "viewer.nats",
    "viewer.model": "viewer.scene",
    "viewer.viewer_settings": "viewer.qr viewer.settings",
}
"""Names of modules below `core`: those of today, and the earlier ones of each, besides those with another package."""


class EarlierNames(MetaPathFinder, Loader):
    """Finds modules under their earlier names; they are the same modules.

    Parameters
    ----------
    root : str
        Name of the package to which all names are relative.
    modules : mapping of str to str
        The earlier names of modules, separated by spaces, by that of today.
    packages : mapping of str to str
        Names of today of packages by their earlier ones; all their other modules keep their names.
    """

    def __init__(self, root: str, modules: Mapping[str, str], packages: Mapping[str, str]) -> None:
        self.moved = {earlier: today for today, names in modules.items() for earlier in names.split()} | dict(packages)
        self._root, self._packages = f"{root}.", packages
        self._specs: dict[str, ModuleSpec | None] = {}

    def today(self, fullname: str) -> str:
        """Return the name of today of a module or package, given an earlier one; "" for any other name."""
        name = fullname.removeprefix(self._root)
        package, _, module = name.partition(".")
        if name == fullname or (name not in self.moved and package not in self._packages):
            return ""
        today = self.moved[name] if name in self.moved else f"{self._packages[package]}.{module}"
        return f"{self._root}{today}".replace("..", ".").rstrip(".")

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module that has another name now."""
        return ModuleSpec(fullname, self) if self.today(fullname) else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Import the module of today."""
        today = self.today(spec.name)
        warnings.warn(f"{spec.name} is now {today}", DeprecationWarning, stacklevel=2)
        module = import_module(today)
        self._specs[today] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own specification back, which importing it under another name replaces."""
        module.__spec__ = self._specs.pop(module.__name__)


def install(root: str, modules: Mapping[str, str], packages: Mapping[str, str]) -> None:
    """Let programs import modules under their earlier names; the parameters are those of `EarlierNames`."""
    # First, as a package that has taken in another would otherwise load that one's modules a second time.
    sys.meta_path.insert(0, EarlierNames(root, modules, packages))
