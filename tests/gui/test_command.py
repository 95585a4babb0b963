"""`blender --command facemime ...`: the command in a real Blender, which quits afterwards."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from facemime.core.takes.file import load_take, save_take
from tests.gui.conftest import QUICK, SUITES, copy_archive, place_of
from tests.helpers.gui.window import ROOT
from tests.helpers.takes import performance

CLIP = ROOT / "assets" / "sample" / "sample.mp4"
_DRIVER_THAT_BLENDER_BLOCKS = """
import bpy
bpy.ops.wm.open_mainfile(filepath="head.blend", use_scripts=False)
other = bpy.data.objects.new("Other", None)
bpy.context.scene.collection.objects.link(other)
other.driver_add("location", 0).driver.expression = "noise.random()"
bpy.ops.wm.save_as_mainfile(filepath="blocked.blend")
"""
"""This driver keeps Blender from quitting."""

pytestmark = pytest.mark.thorough


class Installed:
    """Blender without a window in a separate folder, with the extension installed from the command line."""

    def __init__(self, place: Path) -> None:
        self._place = place
        self.folder = Path(tempfile.mkdtemp(prefix="facemime-", dir=place / "tmp"))
        self._inside = Path("/") / self.folder.relative_to(place)
        copy_archive(place, self.folder / "facemime.zip")
        self.run(
            "--command", "extension", "install-file", "-r", "user_default", "--enable", "facemime.zip", timeout=600
        )

    def line(self, *arguments: object) -> list[str]:
        """Return the command that runs Blender in the folder."""
        words = ["env", "-C", str(self._inside), "blender", *map(str, arguments)]
        return ["chroot", str(self._place), *words]

    def environment(self) -> dict[str, str]:
        """Environment variables that make Blender write only to the folder."""
        inside = str(self._inside)
        kept = {"HOME": inside, "TMPDIR": inside, "BLENDER_USER_RESOURCES": f"{inside}/profile", "LANG": "C.UTF-8"}
        return {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"} | kept

    def run(self, *arguments: object, timeout: float = 300.0) -> subprocess.CompletedProcess:
        """Run Blender and wait until it quits."""
        line = self.line(*arguments)
        return subprocess.run(
            line, env=self.environment(), capture_output=True, text=True, timeout=timeout, check=False
        )

    def children(self) -> list[str]:
        """Return the Blender processes that are still running in the folder."""
        found = []
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if b"blender" in (process / "cmdline").read_bytes() and os.readlink(process / "cwd") == str(
                    self.folder
                ):
                    found.append(process.name)
            except OSError:  # it has ended in the meantime
                continue
        return found


@pytest.fixture(
    scope="module", params=[pytest.param(suite, marks=[pytest.mark.thorough] * (suite != QUICK)) for suite in SUITES]
)
def installed(request: pytest.FixtureRequest) -> Iterator[Installed]:
    blender = Installed(place_of(request.param))
    save_take(performance(), blender.folder / "take.facetake")
    shutil.copy(CLIP, blender.folder / "clip.mp4")
    yield blender
    shutil.rmtree(blender.folder)


def test_a_puppet_quits_blender_despite_a_blocked_driver(installed):
    done = installed.run("--command", "facemime", "puppet", "take.facetake", "-o", "head.blend")
    assert done.returncode == 0 and "largest error" in done.stderr, done.stderr
    installed.run("-b", "--python-expr", _DRIVER_THAT_BLENDER_BLOCKS)
    assert (installed.folder / "blocked.blend").exists()
    done = installed.run(
        "--command", "facemime", "puppet", "take.facetake", "-o", "out.blend", "--head", "blocked.blend:Facemime Head"
    )
    assert done.returncode == 0 and (installed.folder / "out.blend").stat().st_size > 10_000, done.stderr


def test_an_error_is_one_line_and_the_exit_status(installed):
    done = installed.run("--command", "facemime", "puppet", "nothing.mp4", "-o", "out.blend")
    assert done.returncode == 1 and "facemime: " in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize(("by", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_quits_blender_and_keeps_the_tracked_part(installed, by, status):
    unfinished, part = installed.folder / "part.unfinished.facetake", installed.folder / "part.interrupted.facetake"
    line = installed.line("--command", "facemime", "puppet", "clip.mp4", "-o", "part.blend")
    with subprocess.Popen(line, env=installed.environment(), stderr=subprocess.PIPE, text=True) as process:
        while not (unfinished.exists() and unfinished.stat().st_size > 5_000):
            assert process.poll() is None
            time.sleep(0.005)
        process.send_signal(by)
        said = process.stderr.read()
    assert process.returncode == status and "Traceback" not in said, said
    assert 0 < len(load_take(part)) < 255 and not unfinished.exists()
    part.unlink()


def test_a_batch_runs_its_clips_in_blender_and_killing_it_ends_them(installed):
    done = installed.run("--command", "facemime", "batch", "clip.mp4", "-o", "batch", timeout=600)
    assert done.returncode == 0, done.stderr
    records = [json.loads(path.read_text()) for path in (installed.folder / "batch").glob("*.json")]
    assert [record["frames"] for record in records if "frames" in record] == [255]
    assert (installed.folder / "batch" / "report.html").exists()
    line = installed.line("--command", "facemime", "batch", "clip.mp4", "-o", "killed")
    with subprocess.Popen(line, env=installed.environment(), stderr=subprocess.DEVNULL) as process:
        while len(installed.children()) < 2:
            assert process.poll() is None
            time.sleep(0.01)
        process.kill()
    end = time.monotonic() + 60.0
    while installed.children() and time.monotonic() < end:
        time.sleep(0.05)
    assert not installed.children()
