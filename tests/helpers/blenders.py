"""Other versions of Blender in which tests run."""

import hashlib
import os
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def blender_python(version: str) -> Path:
    """Return the Python of an environment with only this version of Blender."""
    key = hashlib.sha256((ROOT / "tools" / "requirements" / f"bpy-{version}.txt").read_bytes()).hexdigest()[:12]
    cache = Path(os.environ.get("FACEMIME_CACHE", Path.home() / ".cache" / "facemime"))
    place = cache / f"bpy-{version}-{key}"
    if not (place / ".ready").exists():
        pytest.skip(f"Blender {version} is not set up: make blenders (5.2 needs Python 3.13)")
    return place / "bin" / "python"


def unpack_wheels(python: Path, folder: Path) -> None:
    """Unpack the extension's wheels for Linux and this Python, which those environments do not contain."""
    version = next((python.parents[1] / "lib").glob("python3.*")).name.removeprefix("python").replace(".", "")
    marks = ("-none-any", "-abi3-manylinux", f"-cp{version}-manylinux")
    for wheel in (path for path in (ROOT / "wheels").glob("*.whl") if any(mark in path.name for mark in marks)):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)


def archive(blender: str, platform: str) -> Path:
    """Return the newest zip for a Blender, "4.2" or "5.1" and later, and a platform."""
    found = sorted((ROOT / "dist").glob(f"facemime-*-blender_{blender}-{platform}.zip"))
    if not found:
        pytest.skip("the extension is not built: make build")
    return found[-1]
