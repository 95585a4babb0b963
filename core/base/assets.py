"""What Facemime is shipped with: the folder of its files, and its version."""

import tomllib
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
ASSETS = _ROOT / "assets"


@cache
def version() -> str:
    """Return the version of Facemime, which the extension's manifest states."""
    return str(tomllib.loads((_ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"])
