"""A separate process that opens a camera and writes its frames to the standard output.

Usage: python camera_process.py FOLDERS DEVICE WIDTH HEIGHT RATE, where FOLDERS contain cv2 and numpy, and DEVICE is the
number of a camera, or a path or address that OpenCV can open as a stream.

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
_PATIENCE = 20


def main() -> None:
    """Open the device and write frames until the other end is closed."""
    sys.path[:0] = sys.argv[1].split(os.pathsep)
    out = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # output of a driver must not mix with the frames
    import cv2  # noqa: F401 - on Windows, it would wait forever for a thread that reads a pipe (numpy, issue 24290)

    threading.Thread(target=_end_with_the_caller, daemon=True).start()
    with contextlib.suppress(BrokenPipeError):  # the other end was closed
        _stream(out)
    os._exit(0)  # the clean-up of a driver may hang


def _end_with_the_caller() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


def _stream(out: Any) -> None:
    import cv2

    getattr(cv2.utils, "logging", cv2).setLogLevel(0)
    device, width, height, rate = sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5])
    number = int(device) if device.isdecimal() else None
    capture = _opened(cv2, device, number, width, height, rate)
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


def _opened(cv2: Any, device: str, number: int | None, width: int, height: int, rate: float) -> Any:
    if number is None:
        return cv2.VideoCapture(device)
    capture = cv2.VideoCapture(number, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)
    # Most webcams reach their full rate only with Motion JPEG.
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*"MJPG"))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
    capture.set(cv2.CAP_PROP_FPS, rate)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


def _write(out: Any, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[out.write(view) :]


def _fail(out: Any, reason: str) -> None:
    text = reason.encode()
    _write(out, HEADER.pack(FAILED, time.perf_counter(), 0, 0, len(text)) + text)


if __name__ == "__main__":
    main()
