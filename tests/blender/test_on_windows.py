"""The tests of core, of commands and of operators in Windows' Python with Blender's module for Windows, under wine."""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.helpers.blenders import ROOT, archive
from tests.helpers.wine import as_windows, run_on_windows, windows_blender, windows_python

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(sys.platform == "win32", reason="the tests themselves run there"),
]

_CORE = {
    "bake": ("bake", "mesh", "numeric", "rigs"),
    "cli": ("cli",),
    "heads": ("heads", "deform", "face", "lab"),
    "puppet": ("puppet", "files", "drive"),
    "streams": ("streams", "viewer"),
    "takes": ("takes",),
    "tracking": ("tracking", "control_points", "."),
}
"""Folders of tests/core by the part that they belong to."""
_BLENDER_PARTS = 5
_ELSEWHERE = {
    "core/test_wheel.py": "the embeddable Python has no pip",
    "core/test_blender_types.py": "types are the same on every system",
    "blender/test_versions.py": "it starts other versions of Blender",
    "blender/test_on_windows.py": "it starts the others",
}
"""Suites that do not run on Windows, with the reason."""


def _parts() -> dict[str, list[str]]:
    """Return the suites of each part, which run in one process: a share of the thorough tests has some of the parts."""
    tests = ROOT / "tests"
    parts = {
        part: [suite for folder in folders for suite in sorted((tests / "core" / folder).glob("test_*.py"))]
        for part, folders in _CORE.items()
    }
    blender = sorted((tests / "blender").glob("test_*.py"))
    parts |= {f"blender{n + 1}": blender[n::_BLENDER_PARTS] for n in range(_BLENDER_PARTS)}
    names = {part: [suite.relative_to(tests).as_posix() for suite in suites] for part, suites in parts.items()}
    return {part: [name for name in suites if name not in _ELSEWHERE] for part, suites in names.items()}


PARTS = _parts()


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """A function that returns the JUnit report of a part, which runs once."""
    done: dict[str, ElementTree.Element] = {}

    def report_of(part: str) -> ElementTree.Element:
        if part not in done:
            done[part] = run_part(PARTS[part], tmp_path_factory.mktemp(part))
        return done[part]

    return report_of


def run_part(suites: list[str], folder: Path) -> ElementTree.Element:
    """Run suites, and return the JUnit report."""
    report = folder / "report.xml"
    options = ["-p", "no:cacheprovider", "-m", "not thorough", "--timeout", "300", f"--junitxml={report}"]
    line = [windows_python(folder), "-m", "pytest", *options, "--continue-on-collection-errors"]
    status, said = run_on_windows([*line, *(f"tests/{suite}" for suite in suites)], folder, 1790)
    assert report.exists(), f"Python exited with {status}\n{said[-8000:]}"
    return ElementTree.parse(report).getroot()


@pytest.mark.parametrize(
    ("part", "suite"),
    [
        pytest.param(part, suite, id=f"windows-{part}-{suite.removesuffix('.py')}")
        for part, suites in PARTS.items()
        for suite in suites
    ],
)
def test_every_suite_passes_on_windows(part, suite, reports):
    module = "tests." + suite.removesuffix(".py").replace("/", ".")
    cases = [case for case in reports(part).iter("testcase") if module in (case.get("classname"), case.get("name"))]
    failed = {
        case.get("name"): wrong.text for case in cases for wrong in (*case.iterfind("failure"), *case.iterfind("error"))
    }
    assert not failed, "\n".join(f"{name}:\n{text}" for name, text in failed.items())
    if not cases:
        pytest.skip("all its tests are thorough")


@pytest.mark.parametrize("version", [pytest.param("4.2", id="windows-zip")])
def test_the_zip_installs_puppets_a_head_and_uninstalls_in_blender_for_windows(version, tmp_path):
    zipped = as_windows(archive(version, "windows_x64"))
    program, clip = (as_windows(ROOT / path) for path in ("tests/blender/extension_run.py", "assets/sample/sample.mp4"))
    status, said = run_on_windows([windows_blender(tmp_path), program, zipped, clip], tmp_path, 900)
    measured = json.loads(next((line for line in said.splitlines() if line.startswith("{")), "{}"))
    assert status == 0 and measured, said[-8000:]
    assert measured["vertices"] == 1781 and measured["units"] == 52 and measured["received"] == 3
    assert 3 <= measured["baked"] <= 64 and measured["largest"] > 0.9 and measured["frames"] > 200


def test_every_folder_of_the_core_has_a_part():
    folders = {path.name for path in (ROOT / "tests" / "core").iterdir() if any(path.glob("test_*.py"))}
    assert folders == {folder for part in _CORE.values() for folder in part} - {"."}
