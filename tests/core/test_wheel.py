"""The wheel, installed beside nothing but what it declares, does what the README says."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import facemime
from facemime.core.takes.file import load_take

ROOT = Path(facemime.__file__).parent
SAMPLE = ROOT / "assets" / "sample" / "sample.mp4"
_QUIET = ["--quiet", "--disable-pip-version-check", "--no-deps"]


@pytest.fixture(scope="module")
def python(tmp_path_factory) -> Path:
    """The interpreter of a new environment with the wheel and its declared requirements."""
    folder = tmp_path_factory.mktemp("wheel")
    if not (ROOT / "assets" / "viewer" / "built" / "viewer.js").exists():
        pytest.skip("the viewer's page is missing: make viewer")
    # A copy without the caches of earlier builds, which would be packed even if their sources are gone.
    source = folder / "source"
    files = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split("\0")
    for name in [*filter(None, files), *(f"assets/viewer/built/{name}" for name in ("viewer.js", "viewer.css"))]:
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).symlink_to(ROOT / name)
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", *_QUIET, "--no-build-isolation", "--wheel-dir", folder, source],
        check=True,
        cwd=folder,
    )
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv", symlinks=True)
    (site,) = (folder / "venv").glob("lib/python*/site-packages")
    subprocess.run([sys.executable, "-m", "pip", "install", *_QUIET, "--target", site, wheel], check=True)
    for name in required("facemime", site):
        link(name, site)
    (site / "bin").rename(folder / "bin")
    return folder / "venv" / "bin" / "python"


def required(name: str, site: Path) -> set[str]:
    """Names of the distributions that a wheel in `site` declares, and those that these need."""
    (metadata,) = site.glob(f"{name}-*.dist-info/METADATA")
    lines = metadata.read_text(encoding="utf-8").splitlines()
    wanted = [line.partition(": ")[2] for line in lines if line.startswith("Requires-Dist: ")]
    names: set[str] = set()
    while wanted:
        requirement = Requirement(wanted.pop())
        if requirement.name not in names and (requirement.marker is None or requirement.marker.evaluate({"extra": ""})):
            assert distribution(requirement.name).version in requirement.specifier
            names.add(requirement.name)
            wanted += distribution(requirement.name).requires or []
    return names


def link(name: str, site: Path) -> None:
    """Make a distribution of this environment visible in another one."""
    found = distribution(name)
    for top in {file.parts[0] for file in found.files or [] if file.parts[0] not in ("..", "__pycache__")}:
        if not (site / top).exists():
            (site / top).symlink_to(found.locate_file(top))


def run(python: Path, *arguments: str, cwd: Path) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([python, *arguments], cwd=cwd, env=clean, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_the_example_of_the_readme_runs(python, tmp_path):
    (tmp_path / "clip.mp4").symlink_to(SAMPLE)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith(">>> ")]
    lines[-1] = f">>> print({lines[-1][4:]})"
    assert run(python, "-c", "\n".join(line[4:] for line in lines), cwd=tmp_path).split("\n")[0] == "(1781, 3)"
    place = run(python, "-c", "import facemime; print(facemime.__file__)", cwd=tmp_path)
    assert str(ROOT) not in place, "it is the installed one"


def test_the_command_states_its_version_and_tracks_a_video(python, tmp_path):
    command = "from facemime.cli.entry import start; start()"
    assert run(python, "-c", command, "--version", cwd=tmp_path).startswith("facemime ")
    run(python, "-c", command, "track", str(SAMPLE), "-o", "take.facetake", cwd=tmp_path)
    assert load_take(tmp_path / "take.facetake").found.mean() > 0.95


def test_the_wheel_has_the_files_that_a_viewer_and_a_type_checker_need(python, tmp_path):
    check = (
        "from pathlib import Path; import facemime; from facemime.core.viewer.page import page_files;"
        "assert len(page_files()) == 4; assert (Path(facemime.__file__).parent / 'py.typed').exists()"
    )
    run(python, "-c", check, cwd=tmp_path)
