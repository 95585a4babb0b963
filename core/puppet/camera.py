"""A camera that is read by a separate process.

Drivers hang or crash, and macOS terminates programs that open a camera without permission. This affects only
`camera_process`. Here it becomes a message for the user, and the next `read` tries again, so that a camera that was
unplugged continues when it is back.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import IO

import cv2
import numpy as np

from ..errors import Message, SourceError, messages
from ..files.capture import is_address
from .camera_list import is_numbered, number_and_name, ways_to_open
from .camera_process import FAILED, HEADER
from .sources import LiveFrame, LiveSource
from .windows_cameras import why_refused

PROGRAM = Path(__file__).with_name("camera_process.py")
_OPENING = 30.0 if sys.platform == "win32" else 15.0
"""Seconds without a frame after which a camera that is opened counts as hanging, or is opened in another way."""
_SLOW = 5.0
"""Seconds after which opening a camera takes long."""
_SILENCE = 4.0
"""Seconds without a frame after which a camera that has sent one counts as hanging."""
_RETRY = 2.0
"""Seconds until the next attempt to open a camera."""
_ENDING = 2.0
"""Seconds to wait for a killed process to end. If its driver hangs in the kernel, it ends later."""
_MAX_BYTES = 1 << 28
"""Largest size of a frame in bytes."""


@dataclass(frozen=True)
class CameraSettings:
    """Camera to open, and format to request, from which the camera may deviate.

    Attributes
    ----------
    device : str
        A number, with or without the name of the camera (`CameraName`), a path, or the address of a stream, such as a
        phone's.
    width, height : int
        Size of the frames in pixels.
    rate : float
        Frames per second.
    """

    device: str = "0"
    width: int = 640
    height: int = 480
    rate: float = 30.0


class Camera(LiveSource):
    """Source of the newest frame of a camera.

    Parameters
    ----------
    command : tuple of str, optional
        Command to start instead of `camera_process`, without its arguments.
    opening, silence : float
        Seconds without a frame after which the camera counts as hanging, while it opens and later.
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
        self.name = f"camera {number_and_name(settings.device)[0]}"
        self.settings = settings
        self._command = command or (python_executable(), "-s", str(PROGRAM))
        self._opening, self._silence = opening, silence
        self._news = threading.Condition()
        self._process: subprocess.Popen[bytes] | None = None
        self._listener: threading.Thread | None = None
        self._frame: LiveFrame | None = None
        self._failure = ""
        self._heard = self._retry_at = 0.0
        self._first: float | None = None
        self._last = -1.0
        self._closed = False
        self._ways: list[str] = []
        self._works = False
        self._began = float("inf")

    @property
    def waiting(self) -> str:
        """What to show until there is a frame."""
        if perf_counter() - self._began < _SLOW:
            return Message("Opening the camera ...")
        return Message("Opening the camera ... Some take half a minute")

    def read(self, timeout: float) -> LiveFrame | None:
        """Return the newest frame. See `LiveSource.read`."""
        if not self._ways:
            self._ways, self._began = ways_to_open(self.settings.device), perf_counter()
        with self._news:
            if self._closed:
                return None
            if self._process is None and perf_counter() >= self._retry_at:
                self._open(self._ways[0])
            self._news.wait_for(lambda: self._frame is not None or self._failure or self._closed, timeout)
            frame, self._frame = self._frame, None
            hangs = self._process is not None and perf_counter() - self._heard > self._silence
            failure = "" if frame is not None else self._failure or ("hangs" if hangs else "")
            self._failure = "" if failure else self._failure
        if failure:
            self._end()
            if self._works or not self._ways[1:]:
                self._ways = self._ways if self._works else []
                self._retry_at = perf_counter() + _RETRY
                raise SourceError(explain_failure(failure, self.settings.device))
            self._ways.pop(0)
        return frame

    def close(self) -> None:
        """End the process, which takes at most `_ENDING` seconds. May be called twice."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._end()

    def _open(self, device: str) -> None:
        asked = self.settings
        if not is_numbered(device) and not is_address(device):
            device = os.path.abspath(device)  # which is not taken for an address
        self._failure, self._frame, self._works = "", None, False
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
        """Listen to `process` until it ends, and clean up; runs in a separate thread, as either may take long."""
        self._listen(process)
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Keep the newest frame of `process` until it ends."""
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
            self._heard, self._last, self._works = perf_counter(), time, True
            self._news.notify_all()

    def _end(self) -> None:
        """Kill the process; if it does not end in time, leave it to its listener."""
        with self._news:
            process, self._process = self._process, None
            listener, self._listener = self._listener, None
        if process is None:
            return
        process.kill()
        if listener is not None:
            listener.join(_ENDING)


def _message(stream: IO[bytes]) -> LiveFrame | str | None:
    """Read a frame or the reason of a failure; None at the end."""
    head = stream.read(HEADER.size)
    if len(head) < HEADER.size:
        return None
    kind, taken, height, width, size = HEADER.unpack(head)
    if size > _MAX_BYTES:
        return None
    data = stream.read(size)
    if kind == FAILED:
        return data.decode(errors="replace")
    if len(data) < size or size != 3 * height * width:
        return None
    return LiveFrame(0.0, np.frombuffer(data, np.uint8).reshape(height, width, 3), None, taken)


def module_folders() -> str:
    """Return the folders that contain cv2 and numpy for a child process, separated as in PATH."""
    return os.pathsep.join({str(Path(str(module.__file__)).parents[1]) for module in (cv2, np)})


def python_executable() -> str:
    """Return the Python executable that runs here, also inside Blender; never another one from PATH.

    Raises SourceError if there is none.
    """
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    own = [sys.executable] if "python" in Path(sys.executable or "").name.lower() else []
    names = (f"bin/{version}", "bin/python3", "bin/python.exe", "python.exe")
    for place in (*own, *(os.path.join(folder, name) for folder in (sys.prefix, sys.base_prefix) for name in names)):
        if os.path.isabs(place) and os.path.isfile(place):
            return place
    raise SourceError(_EXPLANATIONS["no python"])


def explain_failure(failure: str, device: str) -> str:
    """Explain a failure of a camera, and what to do.

    The failure is a reason given by `camera_process`, or "hangs", "died" or "no python".
    """
    device, _ = number_and_name(device)
    if failure in ("closed", "silent") and is_numbered(device) and (refused := why_refused()):
        return refused
    path = Path(f"/dev/video{device}") if device.isdecimal() and sys.platform == "linux" else None
    if failure in ("closed", "silent") and path is not None:
        if not os.path.exists(path):
            return Message(
                "No camera {device}. Plug it in, choose another under Source, or use a video.", device=device
            )
        if not os.access(path, os.R_OK | os.W_OK):
            return Message(
                "There is no permission to use {path}. Join the group 'video' and log in again, or use a video.",
                path=path,
            )
    if sys.platform == "darwin" and failure in ("closed", "silent", "died"):
        return Message(
            "macOS did not grant access to the camera. Start Blender from Terminal and allow Terminal in System "
            "Settings > Privacy & Security > Camera, or use a video or a phone's stream."
        )
    return _EXPLANATIONS.get(failure, _EXPLANATIONS["died"])


_EXPLANATIONS = messages(
    {
        "closed": "The camera cannot be opened. Plug it in, close other programs that use it, or choose another.",
        "silent": "The camera sends no images; another program may be using it. Close that, or choose another camera.",
        "gone": "The camera stopped: it was unplugged, or its stream ended. Plug it in again to continue.",
        "hangs": "The camera does not respond. Unplug it and plug it in again, or choose another source.",
        "died": "The driver of the camera crashed. Plug the camera in again, or choose another source.",
        "no python": "Blender's Python, which reads the camera, cannot be started. Reinstall Blender, or use a video.",
    }
)
