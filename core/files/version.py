"""The version, read from the extension's manifest."""

import tomllib
from functools import cache
from pathlib import Path


@cache
def version() -> str:
    """Return the version of Facemime."""
    manifest = Path(__file__).resolve().parents[2] / "blender_manifest.toml"
    return str(tomllib.loads(manifest.read_text(encoding="utf-8"))["version"])
