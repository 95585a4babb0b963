"""The built zip in every supported Blender."""

import hashlib
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.helpers.blenders import ROOT, archive, blender_python

CLIP = ROOT / "assets" / "sample" / "sample.mp4"


@pytest.mark.thorough
@pytest.mark.parametrize("version", ["4.2", "4.5", "5.0", "5.2"])
@pytest.mark.skipif(sys.platform != "linux", reason="the environments are Linux ones")
def test_the_zip_installs_puppets_a_head_and_uninstalls_cleanly(version):
    python, zipped = blender_python(version), archive("5.1" if version == "5.2" else "4.2", "linux_x64")
    command = [str(python), str(ROOT / "tests" / "blender" / "extension_run.py"), str(zipped), str(CLIP)]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, env=environment, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    measured = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    assert measured["blender"].startswith(version)
    assert measured["vertices"] == 1781 and measured["units"] == 52
    assert 3 <= measured["baked"] <= 64 and measured["largest"] > 0.9 and measured["frames"] > 200
    assert re.search(r'src="viewer\.[0-9a-f]+\.js"', measured["page"])
    assert measured["received"] == 3


@pytest.mark.thorough
@pytest.mark.parametrize("version", ["4.2", "4.5", "5.0", "5.2"])
@pytest.mark.skipif(sys.platform != "linux", reason="the environments are Linux ones")
def test_blender_installs_from_the_index_and_updates_an_earlier_version(version, tmp_path):
    python, zipped = blender_python(version), archive("5.1" if version == "5.2" else "4.2", "linux_x64")
    write_earlier(zipped, tmp_path / zipped.name)
    tool = next(
        (python.parents[1] / "lib").glob("python3*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    )
    subprocess.run([str(python), str(tool), "server-generate", "--repo-dir", str(tmp_path)], check=True)
    command = [str(python), str(ROOT / "tests" / "blender" / "index_run.py"), str(tmp_path), str(ROOT / "dist")]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, env=environment, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    measured = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    assert measured == {
        "versions": ["0.1.0", zipped.name.split("-")[1]],
        "kept": True,
        "scene_kept": True,
    }


def write_earlier(zipped: Path, path: Path) -> None:
    """Write a zip of an earlier version."""
    with zipfile.ZipFile(zipped) as new, zipfile.ZipFile(path, "w") as old:
        for name in new.namelist():
            data = new.read(name)
            if name == "blender_manifest.toml":
                data = re.sub(rb'^version = ".*"', b'version = "0.1.0"', data, flags=re.MULTILINE)
            old.writestr(name, data)


@pytest.mark.parametrize("platform", ["linux_x64", "windows_x64", "macos_arm64", "macos_x64"])
@pytest.mark.parametrize(("blender", "python"), [("4.2", "cp311"), ("5.1", "cp313")])
def test_each_zip_contains_its_wheels_and_the_assets_but_no_development_files(blender, python, platform):
    zipped = zipfile.ZipFile(archive(blender, platform))
    names = zipped.namelist()
    wheels = [name.removeprefix("wheels/") for name in names if name.endswith(".whl")]
    pure = [name for name in wheels if name.endswith("-none-any.whl")]
    compiled = sorted(set(wheels) - set(pure))
    marks = {
        "linux_x64": ("linux",),
        "windows_x64": ("win_amd64",),
        "macos_arm64": ("arm64", "universal2"),
        "macos_x64": ("_x86_64", "universal2"),
    }
    assert sorted(name.split("-")[0] for name in pure) == ["threadpoolctl", "websockets"]
    both = (blender, platform) == ("4.2", "linux_x64")
    pythons = ["cp311", "cp313"] if both else [python]
    assert [name.split("-")[0] for name in compiled] == [
        "opencv_contrib_python_headless",
        "pycryptodomex",
        *("scipy" for _ in pythons),
    ]
    assert all(any(mark in name for mark in marks[platform]) for name in compiled)
    assert ["abi3" if "-abi3-" in name else name.split("-")[3] for name in compiled] == ["abi3", "abi3", *pythons]
    manifest = tomllib.loads(zipped.read("blender_manifest.toml").decode())
    assert manifest["blender_version_min"] == f"{blender}.0"
    assert manifest.get("blender_version_max") == {"4.2": "5.1.0"}.get(blender)
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
        "assets/facegen/LICENSE.txt",
        *(f"licences/{name.split('-')[0]}/" for name in wheels),
    ):
        assert any(name.startswith(needed) for name in names), needed
    assert "assets/sample/sample_landmarks.npz" not in names
    for unwanted in ("lab/training/", "tests/", "lab/bench/", "docs/", "tools/", ".", "Makefile", "pyproject.toml"):
        assert not [name for name in names if name.startswith(unwanted)]


def test_the_index_from_which_blender_updates_names_each_zip():
    index = ROOT / "dist" / "index.json"
    if not index.exists():
        pytest.skip("the extension is not built: make build")
    entries = json.loads(index.read_text())["data"]
    assert {entry["archive_url"] for entry in entries} == {f"./{path.name}" for path in index.parent.glob("*.zip")}
    for entry in entries:
        data = (index.parent / entry["archive_url"]).read_bytes()
        assert entry["archive_hash"] == f"sha256:{hashlib.sha256(data).hexdigest()}"
