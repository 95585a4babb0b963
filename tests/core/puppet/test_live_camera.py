"""A camera is read by a separate process; whatever happens to it, the user gets one message and the session goes on.

No machine that tests has a camera. OpenCV reads a file through the same call as a camera's stream, so a clip stands for
the device; drivers that hang or crash are programs that do.
"""

import os
import sys
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
import pytest

import facemime
from facemime.core.errors import SourceError
from facemime.core.puppet import camera as camera_module
from facemime.core.puppet.camera import (
    Camera,
    CameraSettings,
    explain_failure,
    python_executable,
)
from tests.helpers.clocks import PATIENCE
from tests.helpers.commands import needs_posix

SAMPLE = str(Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4")


def until(camera: Camera, condition):
    """Read until `condition` holds for a frame, which is returned, or an error occurs."""
    end = perf_counter() + PATIENCE
    while perf_counter() < end:
        frame = camera.read(0.2)
        if frame is not None and condition(frame):
            return frame
    raise AssertionError("waited in vain")


@pytest.fixture
def camera():
    """Make cameras with patience for a busy machine, and close them at the end."""
    made = []

    def make(*arguments, **options) -> Camera:
        made.append(Camera(*arguments, **{"opening": PATIENCE} | options))
        return made[-1]

    yield make
    for each in made:
        each.close()


def program(tmp_path: Path, text: str) -> tuple[str, ...]:
    """Return a command that runs the program `text` instead of the camera's process."""
    path = tmp_path / "driver.py"
    path.write_text(text)
    return (sys.executable, str(path))


def test_frames_reach_the_reader_with_a_shared_clock(camera):
    source = camera(CameraSettings(SAMPLE))
    first = until(source, lambda frame: True)
    later = until(source, lambda frame: frame.time > 0.2)
    assert first.image.shape == (480, 640, 3) and first.image.std() > 10
    assert first.time == 0.0 and 0.0 <= perf_counter() - later.taken < PATIENCE
    assert source.clock == "monotonic"


def test_a_stream_that_ends_is_reported_and_resumed_when_it_returns(camera, monkeypatch):
    monkeypatch.setattr(camera_module, "_RETRY", 0.1)
    source = camera(CameraSettings(SAMPLE))
    before = until(source, lambda frame: True)
    source._process.kill()
    with pytest.raises(SourceError, match="driver of the camera"):
        until(source, lambda frame: False)
    after = until(source, lambda frame: True)
    assert after.time > before.time


def test_a_hanging_driver_is_ended_and_reported(camera, tmp_path):
    source = camera(
        CameraSettings("7"), command=program(tmp_path, "import time; time.sleep(600)"), opening=0.5, silence=0.5
    )
    with pytest.raises(SourceError, match="does not respond"):
        until(source, lambda frame: True)
    assert source._process is None


@pytest.mark.thorough
def test_a_camera_is_opened_in_another_way_before_it_counts_as_hanging(camera, tmp_path, monkeypatch):
    folder = Path(camera_module.__file__).parent
    monkeypatch.setattr(camera_module, "ways_to_open", lambda text: ["7", "dshow1"])
    text = f"""
import sys, time
sys.path.insert(0, {str(folder)!r})
from camera_process import HEADER, FRAME
if sys.argv[2] == "dshow1":
    sys.stdout.buffer.write(HEADER.pack(FRAME, time.perf_counter(), 2, 3, 18) + bytes(18))
    sys.stdout.flush()
time.sleep(600)
"""
    source = camera(CameraSettings("7"), command=program(tmp_path, text), opening=5.0)
    assert source.waiting == "Opening the camera ..."
    assert until(source, lambda frame: True).image.shape == (2, 3, 3)
    source._process.kill()
    with pytest.raises(SourceError, match="driver of the camera"):
        until(source, lambda frame: False)
    assert until(source, lambda frame: True), "it is opened as before"


def test_a_driver_that_hangs_after_some_frames_is_ended_too(camera, tmp_path):
    folder = Path(camera_module.__file__).parent
    text = f"""
import sys, time
sys.path.insert(0, {str(folder)!r})
from camera_process import HEADER, FRAME
sys.stdout.buffer.write(HEADER.pack(FRAME, time.perf_counter(), 2, 3, 18) + bytes(18))
sys.stdout.flush()
time.sleep(600)
"""
    source = camera(CameraSettings("7"), command=program(tmp_path, text), silence=0.5)
    assert until(source, lambda frame: True).image.shape == (2, 3, 3)
    with pytest.raises(SourceError, match="does not respond"):
        until(source, lambda frame: False)


@pytest.mark.parametrize(
    "text",
    [
        "import os; os.abort()",
        "import sys; sys.stdout.write('rubbish' * 1000)",
        "import sys; sys.stdout.buffer.write(b'FRAM' + bytes([255]) * 40)",
        "pass",
    ],
)
def test_a_driver_that_crashes_or_writes_rubbish_is_reported(camera, tmp_path, text):
    source = camera(CameraSettings("7"), command=program(tmp_path, text))
    with pytest.raises(SourceError, match=r"crashed|cannot be opened|No camera"):
        until(source, lambda frame: True)


def test_a_missing_camera_is_reported(camera):
    if os.path.exists("/dev/video97"):
        pytest.skip("this machine has a camera 97")
    with pytest.raises(SourceError, match="camera 97" if sys.platform == "linux" else "cannot be opened"):
        until(camera(CameraSettings("97")), lambda frame: True)


def test_the_size_of_frames_may_change(camera, tmp_path):
    """Some cameras change the size when the light falls; a program with the real messages stands for such a driver."""
    seen = tmp_path / "seen"
    folder = Path(camera_module.__file__).parent
    text = f"""
import os, sys, time
sys.path.insert(0, {str(folder)!r})
from camera_process import HEADER, FRAME
for height, width in ((4, 6), (8, 10)):
    sys.stdout.buffer.write(HEADER.pack(FRAME, time.perf_counter(), height, width, 3 * height * width))
    sys.stdout.buffer.write(bytes(3 * height * width))
    sys.stdout.flush()
    while not os.path.exists({str(seen)!r}): time.sleep(0.01)
time.sleep(600)
"""
    source = camera(CameraSettings("7"), command=program(tmp_path, text))
    assert until(source, lambda frame: True).image.shape == (4, 6, 3)
    seen.touch()
    assert until(source, lambda frame: True).image.shape == (8, 10, 3)


def test_the_process_ends_with_the_camera(camera):
    source = camera(CameraSettings(SAMPLE))
    until(source, lambda frame: True)
    process = source._process
    source.close()
    source.close()
    assert process.poll() is not None
    assert source.read(0.1) is None


def test_every_failure_is_explained_in_two_sentences():
    for failure in ("closed", "silent", "gone", "hangs", "died", "no python", "something new"):
        text = explain_failure(failure, "http://phone/video")
        assert text.endswith(".") and 30 < len(text) < 200


def test_python_is_not_searched_on_the_path(monkeypatch, tmp_path):
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    (tmp_path / version).touch(mode=0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "none"))
    for executable in ("/opt/blender", "", None, version):
        monkeypatch.setattr(sys, "executable", executable)
        assert Path(python_executable()).is_relative_to(sys.base_prefix)
    monkeypatch.setattr(sys, "base_prefix", str(tmp_path / "none"))
    with pytest.raises(SourceError, match="Blender's Python, which reads the camera, cannot be started"):
        python_executable()


@needs_posix
def test_a_file_named_like_an_address_is_opened_as_a_file(tmp_path, monkeypatch, camera):
    (tmp_path / "12:30.mp4").symlink_to(SAMPLE)
    monkeypatch.chdir(tmp_path)
    assert until(camera(CameraSettings("12:30.mp4")), lambda frame: True).image.shape == (480, 640, 3)


def test_the_python_that_is_started_can_import_opencv():
    assert Path(python_executable()).exists()
    assert np.__version__ and cv2.__version__


def test_an_open_pipe_of_a_dead_driver_does_not_block_the_reader(camera, tmp_path, monkeypatch):
    """A process that hangs in the kernel cannot be killed, and waiting for its end would never return."""
    monkeypatch.setattr(camera_module, "_ENDING", 0.2)
    seen = tmp_path / "seen"
    text = f"""
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
with open({str(seen)!r}, "w") as file: file.write(str(child.pid))
time.sleep(600)
"""
    source = camera(CameraSettings("7"), command=program(tmp_path, text))
    while not seen.exists() or not seen.read_text():
        assert source.read(0.05) is None
    listener = source._listener
    source.close()
    assert listener.is_alive()
    os.kill(int(seen.read_text()), 9)
    listener.join(PATIENCE)
    assert not listener.is_alive()
