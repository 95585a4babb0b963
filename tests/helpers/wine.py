"""Windows' Python, with Blender's module, under wine."""

import contextlib
import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.helpers.blenders import ROOT
from tests.helpers.programs import program

_FILES = ("python.exe", "python3.dll", "python311.dll", "vcruntime140.dll", "vcruntime140_1.dll")
"""All that an environment needs of its own."""
_ENDING = 5.0
"""Seconds in which the rest of the output of a program that has ended is read."""
_OF_BLENDER = (
    "bpy",
    "numpy",
    "numpy.libs",
    "requests",
    "urllib3",
    "idna",
    "certifi",
    "charset_normalizer",
    "zstandard",
)
_QUIET = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)


def windows_python(folder: Path) -> Path:
    """Make an environment in a folder, in which this clone is installed, and return its Python."""
    python = _environment(folder, "true")
    (folder / "source").mkdir()
    (folder / "source" / "facemime").symlink_to(ROOT)
    (_packages(folder / "environment") / "facemime.pth").write_text(as_windows(folder / "source") + "\n")
    return python


def windows_blender(folder: Path) -> Path:
    """Make an environment in a folder, with what Blender has and no more, and return its Python."""
    python = _environment(folder, "false")
    for name in _OF_BLENDER:
        (_packages(folder / "environment") / name).symlink_to(_packages(_place() / "python") / name)
    return python


def _environment(folder: Path, everything: str) -> Path:
    """Make an environment, with all packages or none, and return its Python."""
    place, environment = _place() / "python", folder / "environment"
    _packages(environment).mkdir(parents=True)
    (environment / "Scripts").mkdir()
    for name in _FILES:
        shutil.copyfile(place / name, environment / "Scripts" / name)
    lines = f"home = {as_windows(place)}\ninclude-system-site-packages = {everything}\n"
    (environment / "pyvenv.cfg").write_text(lines)
    return environment / "Scripts" / "python.exe"


def _packages(python: Path) -> Path:
    return python / "Lib" / "site-packages"


def as_windows(path: Path) -> str:
    """Return the name under which a program under wine finds a file."""
    return "Z:" + str(path).replace("/", "\\")


def run_on_windows(line: Sequence[object], folder: Path, timeout: float) -> tuple[int, str]:
    """Run a program under wine, with temporary files in a folder; return its exit status and what it wrote."""
    (folder / "temp").mkdir(exist_ok=True)
    temporary = as_windows(folder / "temp")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST", "VIRTUAL_ENV"))}
    environment |= {"WINEPREFIX": str(_place() / "prefix"), "WINEARCH": "win64", "WINEDEBUG": "-all", "DISPLAY": ""}
    environment |= {"TEMP": temporary, "TMP": temporary, "OPENBLAS_NUM_THREADS": "1"}
    # wine's services outlive the program that starts them, and would keep its output open.
    subprocess.run(["wine", "wineboot"], env=environment, check=True, timeout=300, **_QUIET)
    log = folder / "output.txt"
    # Windows' Python ends with an error if its output is a file.
    with log.open("wb") as file, subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=file) as reader:
        done = subprocess.run(
            ["wine", *map(str, line)],
            env=environment,
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=reader.stdin,
            stderr=subprocess.STDOUT,
            timeout=timeout,
            check=False,
        )
        reader.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):  # a service of wine may still have it open
            reader.wait(_ENDING)
        reader.terminate()
    return done.returncode, log.read_text(errors="replace")


def _place() -> Path:
    """Return where `make wine` has set everything up; skip with the reason if it could not."""
    program("wine")
    requirements = ROOT / "tools" / "requirements"
    recipe = (ROOT / "tools" / "wine.sh", requirements / "wine.txt", requirements / "wine-python.txt")
    key = hashlib.sha256(b"".join(path.read_bytes() for path in recipe)).hexdigest()[:12]
    cache = Path(os.environ.get("FACEMIME_CACHE", Path.home() / ".cache" / "facemime"))
    place = cache / f"wine-{key}"
    if not (place / ".ready").exists():
        pytest.skip("Windows' Python is not set up: make wine")
    return place
