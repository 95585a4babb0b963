"""A camera, read in a process of its own.

Drivers hang, crash, and on macOS the system ends a program that opens a camera without leave. What happens in
`camera_process` happens to that process alone; here it becomes one sentence for the user, and the next `read` tries
again, so that a camera that was unplugged goes on when it is back.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import IO

import cv2
import numpy as np

from ..capture import is_address
from ..errors import SourceError
from .camera_process import FAILED, HEADER
from .sources import LiveFrame, LiveSource

PROGRAM = Path(__file__).with_name("camera_process.py")
_OPENING, _SILENCE, _AGAIN = 15.0, 4.0, 2.0
"""Seconds until a camera that opens, or that gave frames, counts as hanging; and until it is tried again."""
_ENDING = 2.0
"""Seconds to wait for a process that was killed: one whose driver hangs in the kernel dies when that lets go of it."""
_LARGEST = 1 << 28


@dataclass(frozen=True)
class CameraSettings:
    """Which camera, and what is asked of it; it may give something else.

    Attributes
    ----------
    device : str
        A number, a path, or the address of a stream (a telephone's, say).
    width, height : int
        Pixels.
    rate : float
        Frames a second.
    """

    device: str = "0"
    width: int = 640
    height: int = 480
    rate: float = 30.0


class Camera(LiveSource):
    """The newest frame of a camera.

    Parameters
    ----------
    command : sequence of str, optional
        What is started instead of `camera_process`, as far as its arguments.
    opening, silence : float
        Seconds without a frame after which the camera counts as hanging: at first, and later.
    """

    clock = "monotonic"

    def __init__(
        self,
        settings: CameraSettings,
        *,
        command: tuple[str, ...] = (),
        opening: float = _OPENING,
        silence: float = _SILENCE,
    ) -> None:
        self.name = f"camera {settings.device}"
        self.settings = settings
        self._command = command or (python_executable(), "-s", str(PROGRAM))
        self._opening, self._silence = opening, silence
        self._news = threading.Condition()
        self._process: subprocess.Popen[bytes] | None = None
        self._listener: threading.Thread | None = None
        self._frame: LiveFrame | None = None
        self._failure = ""
        self._heard = self._again = 0.0
        self._first: float | None = None
        self._last = -1.0
        self._closed = False

    def read(self, timeout: float) -> LiveFrame | None:
        """The newest frame; see `LiveSource.read`."""
        with self._news:
            if self._closed:
                return None
            if self._process is None and perf_counter() >= self._again:
                self._open()
            self._news.wait_for(lambda: self._frame is not None or self._failure or self._closed, timeout)
            frame, self._frame = self._frame, None
            failure = "" if frame is not None else self._failure or self._hanging()
            self._failure = "" if failure else self._failure
        if failure:
            self._end()
            self._again = perf_counter() + _AGAIN
            raise SourceError(explained(failure, self.settings.device))
        return frame

    def close(self) -> None:
        """End the process, which takes `_ENDING` seconds at most; may be called twice."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._end()

    def _open(self) -> None:
        asked = self.settings
        named = asked.device.isdecimal() or is_address(asked.device)
        device = asked.device if named else os.path.abspath(asked.device)  # which is never taken for an address
        self._failure, self._frame = "", None
        self._heard = perf_counter() + self._opening - self._silence
        try:
            self._process = subprocess.Popen(
                [*self._command, module_folders(), device, str(asked.width), str(asked.height), str(asked.rate)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
        except OSError:
            self._failure = "no python"
            return
        self._listener = threading.Thread(
            target=self._attend, args=(self._process,), name="facemime-camera", daemon=True
        )
        self._listener.start()

    def _attend(self, process: subprocess.Popen[bytes]) -> None:
        """Listen to `process` until it ends, and clear up after it; in a thread of its own, as either may take long."""
        self._listen(process)
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Keep the newest frame of `process` until it says no more."""
        assert process.stdout is not None
        failure = "died"
        try:
            while (message := _message(process.stdout)) is not None:
                if isinstance(message, str):
                    failure = message
                    break
                self._keep(process, message)
        except (OSError, ValueError):
            failure = "died"
        with self._news:
            if process is self._process:
                self._failure = failure
                self._news.notify_all()

    def _keep(self, process: subprocess.Popen[bytes], frame: LiveFrame) -> None:
        with self._news:
            if process is not self._process:
                return
            self._first = frame.taken if self._first is None else self._first
            time = max(frame.taken - self._first, self._last + 1e-4)
            dropped = 0 if self._frame is None else self._frame.dropped + 1
            self._frame = LiveFrame(time, frame.image, None, frame.taken, dropped)
            self._heard, self._last = perf_counter(), time
            self._news.notify_all()

    def _hanging(self) -> str:
        return "hangs" if self._process is not None and perf_counter() - self._heard > self._silence else ""

    def _end(self) -> None:
        """Kill the process; one that does not die in time is left to its listener."""
        with self._news:
            process, self._process = self._process, None
            listener, self._listener = self._listener, None
        if process is None:
            return
        process.kill()
        if listener is not None:
            listener.join(_ENDING)


def _message(stream: IO[bytes]) -> LiveFrame | str | None:
    """A frame, the reason of a failure, or None at the end."""
    head = stream.read(HEADER.size)
    if len(head) < HEADER.size:
        return None
    kind, taken, height, width, size = HEADER.unpack(head)
    if size > _LARGEST:
        return None
    data = stream.read(size)
    if kind == FAILED:
        return data.decode(errors="replace")
    if len(data) < size or size != 3 * height * width:
        return None
    return LiveFrame(0.0, np.frombuffer(data, np.uint8).reshape(height, width, 3), None, taken)


def module_folders() -> str:
    """Where a program that this one starts finds cv2 and numpy, as PATH lists folders."""
    return os.pathsep.join({str(Path(str(module.__file__)).parents[1]) for module in (cv2, np)})


def python_executable() -> str:
    """The Python that runs here, also inside Blender; never one that happens to be on the path for programs.

    Raises
    ------
    SourceError
        Where there is none.
    """
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    own = [sys.executable] if "python" in Path(sys.executable or "").name.lower() else []
    names = (f"bin/{version}", "bin/python3", "bin/python.exe", "python.exe")
    for place in (*own, *(os.path.join(folder, name) for folder in (sys.prefix, sys.base_prefix) for name in names)):
        if os.path.isabs(place) and os.path.isfile(place):
            return place
    raise SourceError(_EXPLANATIONS["no python"])


def explained(failure: str, device: str) -> str:
    """What happened to the camera and what to do, for the user."""
    path = Path(f"/dev/video{device}") if device.isdecimal() and sys.platform == "linux" else None
    if failure in ("closed", "silent") and path is not None:
        if not os.path.exists(path):
            return f"There is no camera {device}. Plug one in, choose another, or use a video."
        if not os.access(path, os.R_OK | os.W_OK):
            return f"You may not use {path}. Add yourself to the group 'video' and log in again, or use a video."
    if sys.platform == "darwin" and failure in ("closed", "silent", "died"):
        return (
            "macOS did not give Blender the camera. Start Blender from Terminal and allow Terminal in System "
            "Settings > Privacy & Security > Camera, or use a video or a telephone's stream."
        )
    return _EXPLANATIONS.get(failure, _EXPLANATIONS["died"]).format(device=device)


_EXPLANATIONS = {
    "closed": "Camera {device} cannot be opened. Plug it in, close other programs that use it, or choose another.",
    "silent": "Camera {device} gives no picture: another program may use it. Close that, or choose another camera.",
    "gone": "Camera {device} stopped: it was unplugged, or its stream ended. Facemime goes on when it is back.",
    "hangs": "Camera {device} does not answer. Unplug it and plug it in again, or choose another source.",
    "died": "The driver of camera {device} broke down. Plug the camera in again, or choose another source.",
    "no python": "Blender's Python cannot be started, which reads the camera. Install Blender anew, or use a video.",
}


@dataclass(frozen=True)
class CameraName:
    """A camera of this computer: what `CameraSettings.device` takes, and the name that the system gives it."""

    device: str
    name: str

    def __str__(self) -> str:
        return f"{self.device}: {self.name}"


def device_of(text: str, cameras: Sequence[CameraName]) -> str:
    """The device that `text` means: a number, an address, or a `CameraName` as text, by its name where it moved."""
    number, separator, name = text.strip().partition(": ")
    if not (separator and number.isdecimal()):
        return text.strip()
    return next((camera.device for camera in cameras if camera.name == name), number)


def list_cameras() -> list[CameraName]:
    """The cameras that the system tells of; opens none. Empty where it tells nothing."""
    if sys.platform == "linux":
        return _listed_by_linux(Path("/sys/class/video4linux"))
    if sys.platform == "darwin":
        return _listed_by_macos()
    return []


def _listed_by_linux(folder: Path) -> list[CameraName]:
    """Of the several devices of one camera the first one gives pictures."""
    cameras = []
    for device in sorted(folder.glob("video*"), key=lambda path: int(path.name[5:] or 0)):
        try:
            if int((device / "index").read_text()) == 0:
                cameras.append(CameraName(device.name[5:], (device / "name").read_text().strip()))
        except (OSError, ValueError):
            continue
    return cameras


def _listed_by_macos() -> list[CameraName]:
    import json

    try:
        done = subprocess.run(
            ["system_profiler", "SPCameraDataType", "-json"], capture_output=True, timeout=10, check=True
        )
        names = [camera["_name"] for camera in json.loads(done.stdout)["SPCameraDataType"]]
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, TypeError):
        return []
    return [CameraName(str(number), name) for number, name in enumerate(names)]
