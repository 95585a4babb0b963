"""Build the extension: get wheels and manual, pack its zips with Blender's own tool, and validate each.

There is a zip per platform and version of Python. A wheel of scipy serves a single version and weighs 30 to 41 MB: a
zip for both versions would weigh 120 to 158 MB rather than 90 to 119 MB. Only on Linux the zip for the earlier Blenders
has both, as distributions build these with a newer Python: Debian 13 has Blender 4.3 with Python 3.13.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from itertools import product
from pathlib import Path

import release

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
WHEELS = ROOT / "wheels"
MANIFEST = "blender_manifest.toml"
PYTHONS = {
    "4.2": ("3.11", 'blender_version_min = "4.2.0"\nblender_version_max = "5.1.0"'),
    "5.1": ("3.13", 'blender_version_min = "5.1.0"'),
}
"""The first Blender of each version of Python, this version, and the lines of the manifest."""
LICENCE = re.compile(r"\.dist-info/(licenses/)?(LICEN[CS]E|COPYING|AUTHORS|NOTICE)[^/]*$")
"""Names of licences in wheels."""
PIP_PLATFORMS = {
    "linux-x64": "manylinux_2_17_x86_64",
    "windows-x64": "win_amd64",
    "macos-arm64": "macosx_13_0_arm64",
    "macos-x64": "macosx_13_0_x86_64",
}


def main() -> int:
    """Build into `dist/`, for the release of a tag if one is given; return the exit status."""
    if sys.argv[1:] and (found := release.problems(sys.argv[1], *release.read())):
        print("\n".join(found), file=sys.stderr)
        return 1
    manifest = tomllib.loads((ROOT / MANIFEST).read_text(encoding="utf-8"))
    fetch_wheels(manifest)
    subprocess.run([sys.executable, str(ROOT / "tools" / "manual.py")], check=True)
    tool = blender_tool()
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    run(tool, "validate", str(ROOT))
    for blender in PYTHONS:
        pack(tool, blender)
    archives = sorted(DIST.glob("*.zip"))
    if len(archives) != len(PYTHONS) * len(manifest["platforms"]):
        print(f"Expected {len(PYTHONS)} archives for each of {manifest['platforms']}; got {archives}", file=sys.stderr)
        return 1
    for archive in archives:
        run(tool, "validate", str(archive))
        print(f"{archive.relative_to(ROOT)}  {archive.stat().st_size / 1e6:.1f} MB")
    run(tool, "server-generate", "--repo-dir", str(DIST))
    return 0


def pack(tool: Path, blender: str) -> None:
    """Pack a zip per platform for the version of Python that `blender`, a key of `PYTHONS`, is the first to have.

    Parameters
    ----------
    tool : Path
    blender : str
    """
    python, versions = PYTHONS[blender]
    others = [f"-cp{other.replace('.', '')}-cp" for other, _ in PYTHONS.values() if other != python]

    def is_unfit(name: str) -> bool:
        both = blender == next(iter(PYTHONS)) and "manylinux" in name
        return not both and any(other in name for other in others)

    with tempfile.TemporaryDirectory() as folder:
        source, packed = Path(folder) / "source", Path(folder) / "packed"
        packed.mkdir()
        left_out = shutil.ignore_patterns(".*", "build", "dist", "__pycache__")
        shutil.copytree(ROOT, source, ignore=lambda at, names: left_out(at, names) | set(filter(is_unfit, names)))
        lines = (ROOT / MANIFEST).read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if not is_unfit(line)]
        own = "\n".join(versions if line.startswith("blender_version_min") else line for line in kept)
        (source / MANIFEST).write_text(own + "\n", encoding="utf-8")
        copy_licences(source / "wheels", source / "licences")
        run(tool, "build", "--source-dir", str(source), "--output-dir", str(packed), "--split-platforms")
        for archive in packed.iterdir():
            name, version, platform = archive.name.split("-")
            shutil.move(archive, DIST / f"{name}-{version}-blender_{blender}-{platform}")


def copy_licences(wheels: Path, folder: Path) -> None:
    """Copy the licences in wheels to a folder per project; of texts that differ by platform, all.

    Parameters
    ----------
    wheels, folder : Path
    """
    for wheel in sorted(wheels.glob("*.whl")):
        with zipfile.ZipFile(wheel) as archive:
            for name in filter(LICENCE.search, archive.namelist()):
                place, text = folder / wheel.name.split("-")[0] / Path(name).name, archive.read(name)
                if place.exists() and place.read_bytes() != text:
                    place = place.with_stem(f"{place.stem}-{wheel.stem.split('-')[-1]}")
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(text)


def fetch_wheels(manifest: dict) -> None:
    """Download the pinned wheels of every platform unless they are present; their hashes are checked.

    Others are removed, such as the one for macOS on Intel that pip prefers to the one for both processors, as Blender's
    tool packs all that it finds.
    """
    named = {Path(wheel).name for wheel in manifest["wheels"]}
    WHEELS.mkdir(exist_ok=True)
    if not named <= {path.name for path in WHEELS.iterdir()}:
        _download_wheels(manifest)
    for path in WHEELS.iterdir():
        if path.name not in named:
            path.unlink()
    if missing := named - {path.name for path in WHEELS.iterdir()}:
        raise SystemExit(
            f"Wheels in blender_manifest.toml that tools/requirements/wheels.txt does not provide: {missing}"
        )


def _download_wheels(manifest: dict) -> None:
    for platform, (python, _) in product(manifest["platforms"], PYTHONS.values()):
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
            + ["--only-binary=:all:", "--python-version", python, "--implementation", "cp"]
            + ["--abi", f"cp{python.replace('.', '')}", "--abi", "abi3"]
            + ["--platform", PIP_PLATFORMS[platform], "--require-hashes", "--dest", str(WHEELS)]
            + ["-r", str(ROOT / "tools" / "requirements" / "wheels.txt")],
            check=True,
        )


def blender_tool() -> Path:
    """Return the extension tool of the bpy package, which runs without Blender."""
    package = Path(sys.prefix).glob("lib/python3*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    found = next(package, None)
    if found is None:
        raise SystemExit("bpy is not installed. Run: make setup")
    return found


def run(tool: Path, *arguments: str) -> None:
    """Run Blender's tool; its output is shown only if it fails.

    Parameters
    ----------
    tool : Path
    *arguments : str
    """
    done = subprocess.run([sys.executable, str(tool), *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"blender_ext {arguments[0]} failed:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    sys.exit(main())
