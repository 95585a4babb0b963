"""The version, read from the manifest so that it stands in one place."""

import tomllib
from functools import cache
from pathlib import Path


@cache
def version() -> str:
    """The version of Facemime, as the extension's manifest states it."""
    manifest = Path(__file__).resolve().parents[1] / "blender_manifest.toml"
    return str(tomllib.loads(manifest.read_text(encoding="utf-8"))["version"])
