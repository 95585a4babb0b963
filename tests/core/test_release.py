"""A release has one version, and no placeholders."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import facemime
from tools import release

ROOT = Path(facemime.__file__).parent

CHANGELOG = "# Changelog\n\n## Unreleased\n\n- more\n\n## 1.0.0\n\n### Added\n\n- all\n\n## 0.1.0\n\n- first\n"
MANIFEST = {"version": "1.0.0", "maintainer": "Ada <ada@facemime.org>", "website": "https://facemime.org"}
PROJECT = {"urls": {"Support": "https://facemime.org/support"}}


def test_this_version_is_in_the_changelog():
    manifest, project, changelog = release.read()
    found = release.problems(f"v{manifest['version']}", manifest, project, changelog)
    assert found == release.placeholders(manifest, project)


def test_a_version_on_which_all_agree_can_be_released():
    assert release.problems("v1.0.0", MANIFEST, PROJECT, CHANGELOG) == []
    assert release.notes(CHANGELOG, "1.0.0") == "### Added\n\n- all"


@pytest.mark.parametrize(
    ("tag", "change", "problem"),
    [
        ("v1.0.1", {}, "The tag is v1.0.1"),
        ("v1.1.0", {"version": "1.1.0"}, "no section 1.1.0"),
        ("v1.0.0", {"website": "https://facemime.invalid"}, "website"),
        ("v1.0.0", {"website": ""}, "website"),
        ("v1.0.0", {"maintainer": "Facemime maintainers <maintainers@facemime.invalid>"}, "maintainer"),
        ("v1.0.0", {"maintainer": "Name <name@example.com>"}, "maintainer"),
    ],
)
def test_versions_that_differ_and_placeholders_are_refused(tag, change, problem):
    (found,) = release.problems(tag, MANIFEST | change, PROJECT, CHANGELOG)
    assert problem in found


def test_an_address_for_support_is_required():
    (found,) = release.problems("v1.0.0", MANIFEST, {}, CHANGELOG)
    assert "Support" in found


def test_the_holders_of_every_library_in_the_zip_are_named():
    manifest, _, _ = release.read()
    holders = {
        "opencv_contrib_python_headless": "OpenCV's contributors",
        "pycryptodomex": "PyCryptodome",
        "scipy": "SciPy Developers",
        "threadpoolctl": "threadpoolctl",
        "websockets": "websockets",
    }
    named = "\n".join(manifest["copyright"])
    libraries = {wheel.removeprefix("./wheels/").split("-")[0] for wheel in manifest["wheels"]}
    assert libraries == holders.keys()
    assert all(holder in named for holder in [*holders.values(), "three.js", "ICT-FaceKit", "FaceGen"])


def workflow(name: str) -> dict:
    return yaml.safe_load((ROOT / ".github" / "workflows" / f"{name}.yml").read_text())


def commands(name: str) -> str:
    return "\n".join(step.get("run", "") for job in workflow(name)["jobs"].values() for step in job["steps"])


def test_each_push_is_tested_on_every_system():
    told = workflow("platforms")
    systems = told["jobs"]["test"]["strategy"]["matrix"]["system"]
    assert {system.split("-")[0] for system in systems} == {"ubuntu", "windows", "macos"}
    assert told[True] == {"pull_request": None, "push": None}, "on all branches; YAML reads `on` as true"
    assert "tests/core" in commands("platforms") and "tests/blender" in commands("platforms")


@pytest.mark.parametrize("name", ["ci", "platforms", "release", "weekly"])
def test_workflows_run_only_what_there_is(name):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for line in re.findall(r"\bmake ([^\n]*)", commands(name)):
        assert {word for word in line.split() if "=" not in word} <= targets
    for path in re.findall(r"\b(?:tools|tests|\.ci)/[\w./-]+", commands(name)):
        assert (ROOT / path).exists(), path


def test_a_release_publishes_all_that_was_built():
    published = commands("release")
    assert all(file in published for file in ("dist/*.zip", "dist/*.whl", "dist/index.json", "docs"))
