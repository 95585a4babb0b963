"""The tests of operators, panels and live sessions in all supported versions of Blender."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.helpers.blenders import ROOT, blender_python, unpack_wheels

pytestmark = [pytest.mark.thorough, pytest.mark.timeout(1800)]

RUNNER = ("_pytest", "iniconfig", "packaging", "pluggy", "py", "pygments", "pytest", "pytest_timeout")
"""The test runner and its dependencies, all in pure Python, as those environments contain only bpy."""
SUITES = (
    *("animated_keys", "animation_take", "attached_parts", "character_files", "moved_files", "performers", "soundness"),
    *("bake_modes", "control_points", "earlier_files", "key_table", "lips", "live", "live_deleted", "live_scene"),
    *("exports", "gltf", "identity_keys", "media_in_step", "other_animation", "overruled_poses", "own_placement"),
    *("own_curves", "picture_settings", "time_of_takes"),
    *("chosen_character", "live_keys", "strengths_of_pose", "teaching_controls"),
    *("live_sources", "operators", "own_head", "panels", "pose_targets", "presets", "recording", "regions"),
    *("takes_files", "takes_list"),
)


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """A function that returns the JUnit report of all suites in a version of Blender, which runs once."""
    done: dict[str, ElementTree.Element] = {}

    def report_of(version: str) -> ElementTree.Element:
        if version not in done:
            done[version] = run_suites(version, tmp_path_factory.mktemp(version))
        return done[version]

    return report_of


def run_suites(version: str, folder: Path) -> ElementTree.Element:
    """Run all suites in a version of Blender, and return the JUnit report."""
    python = blender_python(version)
    for name in RUNNER:
        origin = Path(importlib.util.find_spec(name).origin)
        origin = origin.parent if origin.name == "__init__.py" else origin
        (folder / origin.name).symlink_to(origin)
    (folder / "facemime").symlink_to(ROOT)
    unpack_wheels(python, folder)
    suites = [str(ROOT / "tests" / "blender" / f"test_{suite}.py") for suite in SUITES]
    options = ["-p", "no:cacheprovider", "-p", "pytest_timeout", "-W", "ignore::DeprecationWarning"]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST", "VIRTUAL_ENV"))}
    done = subprocess.run(
        [
            str(python),
            "-m",
            "pytest",
            *options,
            "--continue-on-collection-errors",
            f"--junitxml={folder / 'report.xml'}",
            *suites,
        ],
        env=environment | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=1790,
        check=False,
    )
    assert (folder / "report.xml").exists(), (
        f"Blender exited with {done.returncode}\n{done.stdout[-6000:]}{done.stderr[-2000:]}"
    )
    return ElementTree.parse(folder / "report.xml").getroot()


@pytest.mark.parametrize("suite", SUITES)
@pytest.mark.parametrize("version", ["4.2", "5.0", "5.2"])
@pytest.mark.skipif(sys.platform != "linux", reason="the environments are Linux ones")
def test_every_suite_passes_in_this_blender(version, suite, reports):
    cases = [case for case in reports(version).iter("testcase") if case.get("classname", "").endswith(f".test_{suite}")]
    failed = {
        case.get("name"): wrong.text for case in cases for wrong in (*case.iterfind("failure"), *case.iterfind("error"))
    }
    assert cases, "no test of this suite was run"
    assert not failed, "\n".join(f"{name}:\n{text}" for name, text in failed.items())
