"""Expressions of a VRM avatar (0.x and 1.0): what its file says that each does to the mesh."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..files.reading import as_integer, as_list, as_number, as_object, as_text

_MAX = 10_000
"""Largest number of expressions, and of binds of one."""
_PERCENT = 100.0
"""Weight of a bind of VRM 0 that shows a morph target fully."""
_VRM0 = {"blink_l": "Blink_L", "blink_r": "Blink_R", "lookup": "LookUp", "lookdown": "LookDown"}
_VRM0 |= {"lookleft": "LookLeft", "lookright": "LookRight"}
"""Names of presets of VRM 0 whose case is not that of a title."""


@dataclass(frozen=True)
class MorphBind:
    """A morph target (`target`) of a mesh (`mesh`), both by index, and its weight in an expression, usually 0 to 1."""

    mesh: int
    target: int
    weight: float


def expressions_of(gltf: Mapping[str, Any]) -> dict[str, list[MorphBind]]:
    """Return the morph targets of each expression of a VRM avatar; nothing for other files.

    Parameters
    ----------
    gltf : mapping
        JSON of the file.

    Returns
    -------
    dict of str to list of MorphBind
        Presets have the names of Facemime's key mappings.

    Raises
    ------
    ValueError
        If it is damaged.
    """
    extensions = as_object(gltf.get("extensions", {}), "extensions")
    found = _of_vrm1(extensions["VRMC_vrm"], gltf) if "VRMC_vrm" in extensions else _of_vrm0(extensions.get("VRM", {}))
    return {name: binds for name, binds in found if binds}


def _of_vrm1(extension: Any, gltf: Mapping[str, Any]) -> Iterator[tuple[str, list[MorphBind]]]:
    groups = as_object(as_object(extension, "VRMC_vrm").get("expressions", {}), "expressions")
    nodes = as_list(gltf.get("nodes", []), "nodes", 1 << 20)
    for group in ("preset", "custom"):
        for name, expression in as_object(groups.get(group, {}), group).items():
            binds = []
            for bind in as_list(as_object(expression, name).get("morphTargetBinds", []), name, _MAX):
                node = nodes[as_integer(as_object(bind, name).get("node"), "node", 0, len(nodes) - 1)]
                binds.append(_bind(as_object(node, "a node").get("mesh"), bind, 1.0))
            yield name, binds


def _of_vrm0(extension: Any) -> Iterator[tuple[str, list[MorphBind]]]:
    master = as_object(as_object(extension, "VRM").get("blendShapeMaster", {}), "blendShapeMaster")
    for item in as_list(master.get("blendShapeGroups", []), "blendShapeGroups", _MAX):
        group = as_object(item, "a group")
        preset = as_text(group.get("presetName", "unknown"), "presetName")
        own = as_text(group.get("name", ""), "name")
        name = own if preset.lower() == "unknown" else _VRM0.get(preset.lower(), preset.title())
        binds = as_list(group.get("binds", []), "binds", _MAX)
        yield name, [_bind(as_object(bind, name).get("mesh"), bind, _PERCENT) for bind in binds]


def _bind(mesh: Any, bind: Mapping[str, Any], full: float) -> MorphBind:
    weight = as_number(bind.get("weight", full), "weight", -_MAX, _MAX) / full
    return MorphBind(as_integer(mesh, "mesh", 0, 1 << 20), as_integer(bind.get("index"), "index", 0, 1 << 20), weight)
