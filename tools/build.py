"""Build the extension: get wheels and manual, pack a zip per platform with Blender's own tool, and validate each."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
WHEELS = ROOT / "wheels"
PIP_PLATFORMS = {
    "linux-x64": "manylinux_2_17_x86_64",
    "windows-x64": "win_amd64",
    "macos-arm64": "macosx_13_0_arm64",
    "macos-x64": "macosx_13_0_x86_64",
}


def main() -> int:
    """Build into `dist/`; return the exit status."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    fetch_wheels(manifest)
    subprocess.run([sys.executable, str(ROOT / "tools" / "manual.py")], check=True)
    tool = blender_tool()
    shutil.rmtree(DIST, ignore_errors=True)
    DIST.mkdir()
    run(tool, "validate", str(ROOT))
    run(tool, "build", "--source-dir", str(ROOT), "--output-dir", str(DIST), "--split-platforms")
    archives = sorted(DIST.glob("*.zip"))
    if len(archives) != len(manifest["platforms"]):
        print(f"Expected {len(manifest['platforms'])} archives; got {len(archives)}", file=sys.stderr)
        return 1
    for archive in archives:
        run(tool, "validate", str(archive))
        print(f"{archive.relative_to(ROOT)}  {archive.stat().st_size / 1e6:.1f} MB")
    return 0


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
    for platform in manifest["platforms"]:
        subprocess.run(
            [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
            + ["--only-binary=:all:", "--python-version", "3.11", "--implementation", "cp", "--abi", "abi3"]
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
