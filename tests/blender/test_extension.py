"""The built zip in every supported Blender."""

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.helpers.blenders import ROOT, blender_python

CLIP = ROOT / "assets" / "sample" / "sample.mp4"


def archive(platform: str) -> Path:
    """Return the newest zip of a platform."""
    found = sorted((ROOT / "dist").glob(f"facemime-*-{platform}.zip"))
    if not found:
        pytest.skip("the extension is not built: make build")
    return found[-1]


@pytest.mark.thorough
@pytest.mark.parametrize("version", ["4.2", "4.5", "5.0", "5.2"])
@pytest.mark.skipif(sys.platform != "linux", reason="the environments are Linux ones")
def test_the_zip_installs_puppets_a_head_and_uninstalls_cleanly(version):
    python = blender_python(version)
    command = [str(python), str(ROOT / "tests" / "blender" / "extension_run.py"), str(archive("linux_x64")), str(CLIP)]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, env=environment, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    measured = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    assert measured["blender"].startswith(version)
    assert measured["vertices"] == 1781 and measured["units"] == 52
    assert 3 <= measured["baked"] <= 64 and measured["largest"] > 0.9 and measured["frames"] > 200
    assert re.search(r'src="viewer\.[0-9a-f]+\.js"', measured["page"])
    assert measured["received"] == 3


@pytest.mark.parametrize("platform", ["linux_x64", "windows_x64", "macos_arm64", "macos_x64"])
def test_each_zip_contains_its_wheels_and_the_assets_but_no_development_files(platform):
    names = zipfile.ZipFile(archive(platform)).namelist()
    wheels = [name for name in names if name.endswith(".whl") and not name.endswith("-none-any.whl")]
    assert [name for name in names if name.startswith("wheels/websockets-") and name.endswith("-none-any.whl")]
    marks = {
        "linux_x64": ("linux",),
        "windows_x64": ("win_amd64",),
        "macos_arm64": ("arm64", "universal2"),
        "macos_x64": ("macosx_13_0_x86", "universal2"),
    }
    assert {name.split("-")[0] for name in wheels} == {
        "wheels/opencv_contrib_python_headless",
        "wheels/pycryptodomex",
    }
    assert len(wheels) == 2
    assert all(any(mark in name for mark in marks[platform]) for name in wheels)
    for needed in (
        "__init__.py",
        "LICENSE",
        "assets/sample/sample.mp4",
        "assets/head/head.npz",
        "assets/head/woman.npz",
        "assets/MODEL_CARD.md",
        "assets/viewer/index.html",
        "assets/viewer/built/viewer.js",
        "assets/viewer/built/LICENSE",
    ):
        assert needed in names
    for unwanted in ("lab/training/", "tests/", "lab/bench/", "docs/", "tools/", ".", "Makefile", "pyproject.toml"):
        assert not [name for name in names if name.startswith(unwanted)]
