"""A separate process that opens a camera and writes its frames to the standard output.

Usage: python camera_process.py FOLDERS DEVICE WIDTH HEIGHT RATE, where FOLDERS contain cv2 and numpy, and DEVICE is the
number of a camera, after "dshow" if it is one of DirectShow, or a path or address that OpenCV can open as a stream.

A driver that hangs, crashes or is refused by the system affects only this process, not Blender. Nothing of Facemime is
imported, as its package is not on the path. A message is `HEADER` (kind, time.perf_counter(), which all processes of a
machine share, height, width, number of bytes) followed by BGR pixels, or by a reason in UTF-8. The process ends with
its standard input, that is, with the process that started it, even if that crashes.
"""

import contextlib
import os
import struct
import sys
import threading
import time
from typing import Any

HEADER = struct.Struct("<4sdIIQ")
FRAME, FAILED = b"FRAM", b"FAIL"
_DIRECTSHOW = "dshow"
_NEARLY = 0.5
"""Difference in pixels or frames per second up to which a format is the one that was asked for."""
_PATIENCE = 20
_POLL = 0.1
"""Seconds between two looks at the standard input."""


def main() -> None:
    """Open the device and write frames until the other end is closed."""
    sys.path[:0] = sys.argv[1].split(os.pathsep)
    out = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # output of a driver must not mix with the frames
    # Before the import: Media Foundation's hardware transforms can take minutes to start (OpenCV, issue 17687).
    os.environ.setdefault("OPENCV_VIDEOIO_MSMF_ENABLE_HW_TRANSFORMS", "0")
    threading.Thread(target=_end_with_the_caller, daemon=True).start()
    with contextlib.suppress(BrokenPipeError):  # the other end was closed
        _stream(out)
    os._exit(0)  # the clean-up of a driver may hang


def _end_with_the_caller() -> None:
    wait_for_end_of_input()
    os._exit(0)


def wait_for_end_of_input() -> None:
    """Wait until the standard input, a pipe, is closed at its other end; what comes through it is ignored.

    On Windows, a thread that reads a pipe blocks every other use of it. A library that examines the standard input when
    it is loaded, as numpy and Blender do, would wait forever. There, the pipe is therefore polled.
    """
    if sys.platform == "win32":
        import ctypes
        import msvcrt

        pipe = ctypes.c_void_p(msvcrt.get_osfhandle(0))
        while ctypes.windll.kernel32.PeekNamedPipe(pipe, None, 0, None, None, None):
            time.sleep(_POLL)
        return
    with contextlib.suppress(OSError):
        while os.read(0, 1024):
            pass


def _stream(out: Any) -> None:
    import cv2

    getattr(cv2.utils, "logging", cv2).setLogLevel(0)
    device, width, height, rate = sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5])
    number = camera_number(device)
    capture = cv2.VideoCapture(device) if number is None else opened(cv2, device, number)
    if number is not None and capture.isOpened():
        ask(cv2, capture, width, height, rate)
    if not capture.isOpened():
        return _fail(out, "closed")
    paced = number is None and capture.get(cv2.CAP_PROP_FRAME_COUNT) > 0
    step = 1.0 / (capture.get(cv2.CAP_PROP_FPS) or 30.0)
    frames = misses = 0
    while misses < _PATIENCE:
        read, image = capture.read()
        if not read:
            misses += 1
            time.sleep(0.02)
            continue
        frames, misses = frames + 1, 0
        pixels = image.tobytes()
        out.write(HEADER.pack(FRAME, time.perf_counter(), *image.shape[:2], len(pixels)))
        _write(out, pixels)
        if paced:
            time.sleep(step)
    return _fail(out, "gone" if frames else "silent")


def camera_number(device: str) -> int | None:
    """Return the number of a camera; None for a path or an address."""
    digits = device.removeprefix(_DIRECTSHOW)
    return int(digits) if digits.isdecimal() else None


def opened(cv2: Any, device: str, number: int) -> Any:
    """Open a numbered camera through the system's own interface, as numbers differ between interfaces."""
    if device.startswith(_DIRECTSHOW):
        return cv2.VideoCapture(number, cv2.CAP_DSHOW)
    interfaces = {"linux": cv2.CAP_V4L2, "win32": cv2.CAP_MSMF, "darwin": cv2.CAP_AVFOUNDATION}
    return cv2.VideoCapture(number, interfaces.get(sys.platform, cv2.CAP_ANY))


def ask(cv2: Any, capture: Any, width: int, height: int, rate: float) -> None:
    """Request a format.

    Media Foundation opens the camera again for each property, also for those that are given when it is opened, and some
    cameras take seconds for it. It is therefore asked only for what is not so already, and chooses the encoding itself.
    """
    if capture.getBackendName() == "MSMF":
        wanted = {cv2.CAP_PROP_FRAME_WIDTH: width, cv2.CAP_PROP_FRAME_HEIGHT: height, cv2.CAP_PROP_FPS: rate}
        for name, value in wanted.items():
            if abs(capture.get(name) - value) > _NEARLY:
                capture.set(name, value)
        return
    # Most webcams reach their full rate only with Motion JPEG.
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*"MJPG"))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
    capture.set(cv2.CAP_PROP_FPS, rate)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)


def _write(out: Any, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[out.write(view) :]


def _fail(out: Any, reason: str) -> None:
    text = reason.encode()
    _write(out, HEADER.pack(FAILED, time.perf_counter(), 0, 0, len(text)) + text)


if __name__ == "__main__":
    main()
