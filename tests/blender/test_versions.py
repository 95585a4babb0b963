"""What is tested in one Blender is tested in all: every operator, panel and live session."""

import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from blenders import ROOT, blender_python

pytestmark = [pytest.mark.thorough, pytest.mark.timeout(1800)]

RUNNER = ("_pytest", "iniconfig", "packaging", "pluggy", "py", "pygments", "pytest", "pytest_timeout")
"""The test runner and what it needs, all of it plain Python; those environments hold bpy alone."""
SUITES = (
    *("bake_ways", "control_points", "key_table", "lips", "live", "live_deleted", "live_scene", "live_sources"),
    *(
        "operators",
        "own_head",
        "panels",
        "pose_targets",
        "presets",
        "recording",
        "regions",
        "takes_files",
        "takes_list",
    ),
)


@pytest.mark.parametrize("version", ["4.2", "5.0", "5.2"])
@pytest.mark.skipif(sys.platform != "linux", reason="the environments are Linux ones")
def test_operators_panels_and_live_sessions_hold_in_this_blender_too(version, tmp_path):
    python = blender_python(version)
    for name in RUNNER:
        origin = Path(importlib.util.find_spec(name).origin)
        origin = origin.parent if origin.name == "__init__.py" else origin
        (tmp_path / origin.name).symlink_to(origin)
    (tmp_path / "facemime").symlink_to(ROOT)
    with zipfile.ZipFile(next((ROOT / "wheels").glob("*manylinux*.whl"))) as wheel:
        wheel.extractall(tmp_path)
    suites = [str(ROOT / "tests" / "blender" / f"test_{suite}.py") for suite in SUITES]
    options = ["-p", "no:cacheprovider", "-p", "pytest_timeout", "-W", "ignore::DeprecationWarning"]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [str(python), "-m", "pytest", *options, *suites],
        env=environment | {"PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=1790,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
