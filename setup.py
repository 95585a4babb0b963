"""Reads the version from the extension's manifest, the only place that states it; the rest is in pyproject.toml."""

import tomllib
from pathlib import Path

from setuptools import setup

setup(version=tomllib.loads((Path(__file__).parent / "blender_manifest.toml").read_text())["version"])
