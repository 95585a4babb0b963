"""The cameras of this computer: their names, and the numbers by which OpenCV opens them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from ..files.capture import is_address
from . import windows_cameras

DIRECTSHOW = "dshow"
"""What precedes the number of a camera in DirectShow, the older interface of Windows."""
_NUMBER = re.compile(rf"(?:{DIRECTSHOW})?\d+")
_FRESH = 5.0
"""Seconds for which a list of cameras counts as new."""


@dataclass(frozen=True)
class CameraName:
    """A camera of this computer: its number, which may follow `DIRECTSHOW`, and its name in the system."""

    device: str
    name: str

    def __str__(self) -> str:
        return f"{self.device}: {self.name}"


def is_numbered(device: str) -> bool:
    """Return whether a device is the number of a camera, rather than a path or an address."""
    return _NUMBER.fullmatch(device) is not None


def number_and_name(text: str) -> tuple[str, str]:
    """Split the device that a user chose or typed into a device and the name of a camera, "" if it has none."""
    number, separator, name = text.strip().partition(": ")
    return (number, name) if separator and is_numbered(number) else (text.strip(), "")


def parse_device(text: str, cameras: Sequence[CameraName]) -> str:
    """Parse the device that a user chose or typed: a number, a name, a `CameraName` as text, a path or an address.

    A named camera is found by its name if its number has changed.
    """
    number, name = number_and_name(text)
    return next((camera.device for camera in cameras if camera.name in (name, number)), number)


def ways_to_open(text: str) -> list[str]:
    """Return the devices by which a camera can be opened, the best first; more than one only on Windows.

    A name needs the list of cameras, which may take a second.
    """
    number, name = number_and_name(text)
    if is_address(number) or os.path.exists(number) or (is_numbered(number) and not name and sys.platform != "win32"):
        return [number]
    cameras = list_cameras()
    device = parse_device(text, cameras)
    return [device, *_in_directshow(device, cameras)] if sys.platform == "win32" and is_numbered(device) else [device]


def _in_directshow(device: str, cameras: Sequence[CameraName]) -> list[str]:
    """Return the number in DirectShow of a camera of Media Foundation: that with its name, of several the same one."""
    if device.startswith(DIRECTSHOW):
        return []
    first, second = ([c for c in cameras if c.device.startswith(DIRECTSHOW) == older] for older in (False, True))
    name = next((camera.name for camera in first if camera.device == device), None)
    if name is None:
        return [DIRECTSHOW + device]
    same = [camera.device for camera in first if camera.name == name].index(device)
    return [camera.device for camera in second if camera.name.startswith(name)][same : same + 1]


def list_cameras() -> list[CameraName]:
    """Return the cameras that the system lists, without opening any; empty if it lists none."""
    if sys.platform == "linux":
        return _list_on_linux(Path("/sys/class/video4linux"))
    if sys.platform == "darwin":
        return _list_on_macos()
    if sys.platform == "win32":
        return _list_on_windows()
    return []


def _list_on_linux(folder: Path) -> list[CameraName]:
    """List cameras on Linux. Of several devices of a camera, the first one delivers the images."""
    cameras = []
    for device in sorted(folder.glob("video*"), key=lambda path: int(path.name[5:] or 0)):
        try:
            if int((device / "index").read_text()) == 0:
                cameras.append(CameraName(device.name[5:], (device / "name").read_text().strip()))
        except (OSError, ValueError):
            continue
    return cameras


def _list_on_macos() -> list[CameraName]:
    """List cameras on macOS in the order in which OpenCV numbers them: that of their identifiers."""
    try:
        done = subprocess.run(
            ["system_profiler", "SPCameraDataType", "-json"], capture_output=True, timeout=10, check=True
        )
        found = [
            (str(camera["spcamera_unique-id"]), str(camera["_name"]))
            for camera in json.loads(done.stdout)["SPCameraDataType"]
        ]
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        return []
    return [CameraName(str(number), name) for number, (_, name) in enumerate(sorted(found))]


def _list_on_windows() -> list[CameraName]:
    """List the cameras of Media Foundation, then those of DirectShow, which has virtual ones that the former lacks."""
    cameras = []
    for prefix, interface, note in (
        ("", "Media Foundation", ""),
        (DIRECTSHOW, "DirectShow", " (DirectShow)"),
    ):
        try:
            cameras += [
                CameraName(f"{prefix}{number}", name + note)
                for number, name in enumerate(windows_cameras.camera_names(interface))
            ]
        except OSError:
            continue
    return cameras


class CameraList:
    """A list of cameras that is made in the background, as a system may take a second for it."""

    def __init__(self) -> None:
        self._cameras: list[CameraName] = []
        self._made = float("-inf")
        self._maker: threading.Thread | None = None

    def prepare(self) -> None:
        """Begin to list the cameras, unless they have been listed."""
        if self._maker is None:
            self._refresh()

    def cameras(self, patience: float) -> list[CameraName]:
        """Return the cameras; if listing them takes more than `patience` seconds, as they were before."""
        if monotonic() - self._made > _FRESH:
            self._refresh()
        if self._maker is not None:
            self._maker.join(patience)
        return self._cameras

    def _refresh(self) -> None:
        if self._maker is None or not self._maker.is_alive():
            self._maker = threading.Thread(target=self._make, name="facemime-cameras", daemon=True)
            self._maker.start()

    def _make(self) -> None:
        self._cameras, self._made = list_cameras(), monotonic()
