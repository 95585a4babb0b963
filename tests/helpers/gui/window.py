"""Blender with a window on a virtual screen: start it, query it, click in it, take screenshots."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
MODULE = "bl_ext.user_default.facemime"
SHOTS = Path(os.environ.get("FACEMIME_SHOTS", ROOT / "build" / "gui"))
_DEADLINE = 120.0
"""Seconds that a test waits: Blender renders in software, and the machine may be busy."""
_STARTUP = """
for screen in bpy.data.screens:
    for area in screen.areas:
        if area.type == "VIEW_3D":
            overlay = area.spaces.active.overlay
            overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = False
bpy.ops.wm.save_homefile()
"""
"""The grid takes half of the time in which a processor draws the default scene."""


class GuiError(AssertionError):
    """Blender did not do what a test was waiting for."""


def places() -> dict[str, Path]:
    """Return the folders in which `tools/windows.sh` keeps each Blender, by the name of the Debian release."""
    cache = Path(os.environ.get("FACEMIME_CACHE", Path.home() / ".cache" / "facemime"))
    listed = subprocess.run(
        ["sh", str(ROOT / "tools" / "windows.sh"), "places"],
        env=os.environ | {"FACEMIME_CACHE": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return {suite: Path(place) for suite, place in (line.split(" ", 1) for line in listed.stdout.splitlines())}


class Blender:
    """Context manager: Blender in a chroot, with its window in the corner of a virtual screen.

    Parameters
    ----------
    place : Path
        The chroot.
    shots : str
        Folder under build/gui for screenshots.
    size : tuple of int
        Width and height of the screen and the window, pixels.
    """

    def __init__(self, place: Path, shots: str, size: tuple[int, int] = (1100, 780)) -> None:
        self.place, self.size = place, size
        self.shots = SHOTS / shots
        shutil.rmtree(self.shots, ignore_errors=True)
        self.shots.mkdir(parents=True)
        self.folder = Path(tempfile.mkdtemp(prefix="facemime-", dir=place / "tmp"))
        self.inside = Path("/") / self.folder.relative_to(place)
        self._link: socket.socket | None = None
        self._received = b""
        self._count = 0
        self.clicks = 0

    def __enter__(self) -> Blender:
        try:
            self._start_screen()
            self._start_blender()
            self.do(_STARTUP)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _environment(self) -> dict[str, str]:
        return {
            "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
            "HOME": str(self.inside),
            "TMPDIR": str(self.inside),
            "BLENDER_USER_RESOURCES": str(self.inside / "profile"),
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "MESA_SHADER_CACHE_DIR": "/var/cache/facemime-shaders",  # for all windows of this Blender
            "PYTHONUNBUFFERED": "1",
            "LANG": "C.UTF-8",
        }

    def _start_screen(self) -> None:
        read, write = os.pipe()
        width, height = self.size
        self.screen = subprocess.Popen(
            ["chroot", str(self.place), "Xvfb", "-displayfd", str(write), "-screen", "0", f"{width}x{height}x24"]
            + ["-nolisten", "tcp"],
            env=self._environment(),
            pass_fds=(write,),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as numbers:
            self.display = f":{numbers.readline().strip()}"

    def _start_blender(self) -> None:
        shutil.copy(HERE / "driver.py", self.folder)
        ours, theirs = socket.socketpair()
        self._link = ours
        self.log = self.folder / "log.txt"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                ["chroot", str(self.place), "blender", "--factory-startup", "--gpu-backend", "opengl"]
                + ["-p", "0", "0", str(self.size[0]), str(self.size[1])]
                + ["--python", str(self.inside / "driver.py")],
                env=self._environment() | {"DISPLAY": self.display, "FACEMIME_GUI_LINK": str(theirs.fileno())},
                pass_fds=(theirs.fileno(),),
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        theirs.close()

    def close(self) -> None:
        """Kill Blender and the screen, and keep Blender's output and crash report."""
        for name in ("process", "screen"):
            process = getattr(self, name, None)
            if process is not None and process.poll() is None:
                process.kill()
                process.wait()
        if self._link is not None:
            self._link.close()
        if getattr(self, "log", None) is not None and self.log.exists():
            shutil.copy(self.log, self.shots / "log.txt")
        for report in self.folder.glob("*.crash.txt"):
            shutil.copy(report, self.shots)
        shutil.rmtree(self.folder, ignore_errors=True)

    def printed(self) -> str:
        """Return Blender's output so far."""
        return self.log.read_text(errors="replace")

    def do(self, code: str) -> Any:
        """Run statements in Blender between two events, and return what they assign to the name `value`."""
        answer = self._ask({"code": code})
        if "error" in answer:
            raise GuiError(answer["error"])
        return answer["value"]

    def get(self, expression: str) -> Any:
        """Return the value of an expression in Blender, converted to JSON."""
        return self.do(f"value = {expression}")

    def wait_for(self, expression: str, seconds: float = _DEADLINE) -> Any:
        """Wait until an expression is true in Blender, and return its value."""
        return wait(lambda: self.get(expression), expression, seconds)

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        self._link.settimeout(_DEADLINE * 2)
        try:
            self._link.sendall(json.dumps(request).encode() + b"\n")
            while b"\n" not in self._received:
                part = self._link.recv(1 << 20)
                if not part:
                    raise GuiError(f"Blender ended with status {self.process.wait()}:\n{self.printed()[-4000:]}")
                self._received += part
        except (TimeoutError, BrokenPipeError, ConnectionResetError) as error:
            raise GuiError(f"Blender does not answer ({error!r}):\n{self.printed()[-4000:]}") from error
        line, _, self._received = self._received.partition(b"\n")
        return json.loads(line)

    def redraw(self) -> None:
        """Wait until Blender has handled its events and redrawn."""
        for _ in range(3):
            self.do("pass")

    def input(self, *words: object) -> None:
        """Send real events: arguments of xdotool, with the mouse in pixels from the top left of the window."""
        command = ["chroot", str(self.place), "xdotool", *map(str, words)]
        subprocess.run(command, env=self._environment() | {"DISPLAY": self.display}, check=True, timeout=30)

    def move(self, x: float, y: float) -> None:
        """Move the mouse, pixels from the top left; in two steps, as Blender ignores a mouse that does not move."""
        self.input("mousemove", round(x) - 1, round(y), "mousemove", round(x), round(y))

    def click(self, x: float, y: float) -> None:
        """Click the left button."""
        self.move(x, y)
        self.redraw()
        self.input("click", 1)
        self.clicks += 1

    def drag(self, *points: tuple[float, float]) -> None:
        """Press at the first point, move to the others, release; Blender sees each, however slowly it draws."""
        self.move(*points[0])
        self.redraw()
        self.input("mousedown", 1)
        for point in points[1:]:
            self.redraw()
            self.move(*point)
        self.redraw()
        self.input("mouseup", 1)
        self.redraw()

    def key(self, *keys: str) -> None:
        """Press key combinations, such as ctrl+z."""
        self.input("key", *keys)

    def shot(self, name: str) -> Path:
        """Save a screenshot as build/gui/…/NN-name.png."""
        self._count += 1
        path = self.shots / f"{self._count:02d}-{name}.png"
        self.redraw()
        subprocess.run(
            ["chroot", str(self.place), "import", "-window", "root", str(self.inside / "shot.png")],
            env=self._environment() | {"DISPLAY": self.display},
            check=True,
            timeout=60,
        )
        shutil.move(self.folder / "shot.png", path)
        return path


def wait(condition: Callable[[], Any], what: str, seconds: float = _DEADLINE) -> Any:
    """Wait until `condition` returns a true value, and return it; raises GuiError after `seconds`."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        if time.monotonic() > end:
            raise GuiError(f"waited {seconds:.0f} s in vain for: {what}")
        time.sleep(0.02)
    return found
