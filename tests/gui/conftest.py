"""Fixtures: one Blender per version and test module, with the zip installed as by a user."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import EVERY_FRAME, TOOLS
from tests.helpers.gui.window import MODULE, ROOT, Blender, places

SUITES = ("trixie", "sid")
QUICK = "sid"
"""Suite with the newest Blender; the other one is tested by `make test-all`."""
_INSTALL = """
class FACEMIME_PT_install(bpy.types.Panel):
    bl_label = "Install"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Facemime"
    def draw(self, context):
        button = self.layout.operator("extensions.package_install_files", text="Install from Disk...")
        button.filepath = {path!r}
        button.repo = "user_default"
bpy.utils.register_class(FACEMIME_PT_install)
"""
"""Panel with the button of Blender's preferences, where it is easier to reach."""
_BROWSER = "any(area.type == 'FILE_BROWSER' for area in bpy.context.window.screen.areas)"
_ENABLED = f"__import__('addon_utils').check({MODULE!r}) == (True, True)"


def copy_archive(place: Path, copy: Path) -> None:
    """Copy the built zip for the Blender in a chroot; for sid, whose Python 3.14 no wheel fits, without scipy's wheel.

    There, Debian's own scipy is used.
    """
    suite = place.name.split("-")[1]
    blender = {"trixie": "4.2", "sid": "5.1"}[suite]
    found = sorted((ROOT / "dist").glob(f"facemime-*-blender_{blender}-linux_x64.zip"))
    if not found:
        pytest.skip("the extension is not built: make build")
    if suite == "trixie":
        shutil.copy(found[-1], copy)
        return
    with zipfile.ZipFile(found[-1]) as whole, zipfile.ZipFile(copy, "w") as rest:
        for name in (name for name in whole.namelist() if not name.startswith("wheels/scipy-")):
            data = whole.read(name)
            if name == "blender_manifest.toml":
                data = re.sub(rb'"./wheels/scipy-[^"]*",\s*', b"", data)
            rest.writestr(name, data)


def place_of(suite: str) -> Path:
    """Return the chroot of a suite; skip with a reason if there is none."""
    place = places()[suite]
    if not place.exists():
        reason = ROOT / "build" / "gui" / "no-windows.txt"
        said = reason.read_text(encoding="utf-8").strip() if reason.exists() else "They are set up by: make test-gui"
        pytest.skip(f"Blender's window of Debian {suite} is missing. {said}")
    return place


def install(blender: Blender) -> None:
    """Install the zip with the button and the file browser that it opens."""
    copy_archive(blender.place, blender.folder / "facemime.zip")
    blender.do(_INSTALL.format(path=str(blender.inside / "facemime.zip")))
    Sidebar(blender).press("bpy.ops.extensions.package_install_files")
    blender.wait_for(_BROWSER)
    blender.shot("install")
    blender.move(blender.size[0] * 0.4, blender.size[1] * 0.6)
    blender.redraw()
    blender.key("Return")
    blender.wait_for(_ENABLED, 120.0)
    blender.do("bpy.utils.unregister_class(FACEMIME_PT_install)")
    blender.redraw()


@contextmanager
def installed(suite: str, name: str, size: tuple[int, int]) -> Iterator[Blender]:
    """A Blender with the extension installed, with screenshots in build/gui/<suite>/<name>."""
    with Blender(place_of(suite), f"{suite}/{name}", size) as window:
        install(window)
        yield window


@pytest.fixture(
    scope="module", params=[pytest.param(suite, marks=[pytest.mark.thorough] * (suite != QUICK)) for suite in SUITES]
)
def blender(request: pytest.FixtureRequest) -> Iterator[Blender]:
    """A window with the extension installed. Each test starts with a new file."""
    name = Path(request.module.__file__).stem.removeprefix("test_")
    with installed(request.param, name, size=(960, 1080)) as window:
        yield window


@pytest.fixture
def every_frame(blender: Blender) -> Iterator[None]:
    """Use a clock that waits for slow frames."""
    blender.do(EVERY_FRAME)
    yield
    blender.do("sources.PacedSource.pace = sources.Clock()")


@pytest.fixture
def sidebar(blender: Blender) -> Iterator[Sidebar]:
    """The sidebar in Blender's default scene; afterwards nothing may be running, and there must be no traceback."""
    before = len(blender.printed())
    blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
    blender.do(TOOLS)
    blender.redraw()
    yield Sidebar(blender)
    if blender.process.poll() is None:
        blender.do("bpy.ops.wm.read_homefile(use_factory_startup=False)")
        assert blender.get("workers()") == []
    assert "Traceback" not in blender.printed()[before:]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Take a screenshot when a test fails."""
    report = yield
    window = getattr(item, "funcargs", {}).get("blender")
    if report.failed and call.when == "call" and window is not None and window.process.poll() is None:
        window.shot(f"failed-{item.originalname}")
    return report
