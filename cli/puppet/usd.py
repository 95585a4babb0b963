"""The frame rate of a file, for which USD needs the library that comes with Blender."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import bpy

from ...core.takes.file_rate import rate_of_file

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


def animation_rate(path: Path) -> float | None:
    """Return the frames per second of the animation in a file; None if it states none, or none that can be read."""
    if (rate := rate_of_file(path)) is not None or path.suffix.lower() not in _SUFFIXES:
        return rate
    # Blender's module does not search the folder of its own libraries; Blender 4.2 has no such library.
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    folder = Path(bpy.utils.resource_path("LOCAL"), "python", "lib", version, "site-packages")
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    with suppress(Exception):  # its errors, of a damaged file, have no common class; the importer reports the damage
        from pxr import Usd  # type: ignore[import-not-found]  # in Blender's own Python

        return float(Usd.Stage.Open(str(path)).GetTimeCodesPerSecond())
    return None
