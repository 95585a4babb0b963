"""What Facemime is shipped with: the folder of its files, and its version."""

import tomllib
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
ASSETS = _ROOT / "assets"
SAMPLE = ASSETS / "sample" / "sample.mp4"
"""The clip with which users try Facemime without a camera."""


@cache
def version() -> str:
    """Return the version of Facemime, which the extension's manifest states."""
    return str(tomllib.loads((_ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"])
