"""Names and numbers of cameras on each system, and the ways in which one is opened."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest

from facemime.core.puppet import camera_list, camera_process, windows_cameras
from facemime.core.puppet.camera_list import CameraList, CameraName, list_cameras, parse_device, ways_to_open
from tests.helpers.clocks import PATIENCE
from tests.helpers.owners import UNDER_WINE

needs_windows = pytest.mark.skipif(sys.platform != "win32", reason="interfaces of Windows")


@pytest.fixture
def on_windows(monkeypatch):
    """Let the system be Windows with these cameras."""

    def prepare(media_foundation: list[str], directshow: list[str]) -> None:
        monkeypatch.setattr(camera_list.sys, "platform", "win32")
        found = {"Media Foundation": media_foundation, "DirectShow": directshow}
        monkeypatch.setattr(windows_cameras, "camera_names", found.__getitem__)

    return prepare


def test_a_camera_is_found_by_name_if_its_number_changed():
    cameras = [CameraName("0", "Built-in"), CameraName("4", "Desk: HD")]
    assert parse_device("2: Desk: HD", cameras) == "4"
    assert parse_device("1: Gone", cameras) == "1"
    assert parse_device("Built-in", cameras) == "0" and parse_device("Desk: HD", cameras) == "4"
    assert parse_device(" 3 ", cameras) == "3"
    assert parse_device("http://phone:8080/video", cameras) == "http://phone:8080/video"


def test_cameras_of_macos_are_numbered_as_opencv_does_by_their_identifiers(monkeypatch):
    found = [
        {"_name": "FaceTime HD Camera", "spcamera_unique-id": "6C707041-05AC-0010-0008-000000000001"},
        {"_name": "Desk", "spcamera_unique-id": "0x1000001d6c0103"},
    ]
    said = json.dumps({"SPCameraDataType": found}).encode()
    monkeypatch.setattr(camera_list.sys, "platform", "darwin")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: SimpleNamespace(stdout=said))
    assert list(map(str, list_cameras())) == ["0: Desk", "1: FaceTime HD Camera"]
    assert ways_to_open("0: FaceTime HD Camera") == ways_to_open("FaceTime HD Camera") == ["1"]


@pytest.mark.parametrize("said", [b"", b"[]", b'{"SPCameraDataType": [{"_name": "A"}]}', b'{"SPCameraDataType": 1}'])
def test_a_list_of_macos_that_cannot_be_read_is_empty(monkeypatch, said):
    monkeypatch.setattr(camera_list.sys, "platform", "darwin")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: SimpleNamespace(stdout=said))
    assert list_cameras() == []


def test_windows_lists_the_cameras_of_both_interfaces(on_windows):
    on_windows(["Built-in", "Desk"], ["Desk", "Built-in", "OBS Virtual Camera"])
    shown = ["0: Built-in", "1: Desk"]
    shown += ["dshow0: Desk (DirectShow)", "dshow1: Built-in (DirectShow)", "dshow2: OBS Virtual Camera (DirectShow)"]
    assert list(map(str, list_cameras())) == shown


def test_a_camera_that_does_not_open_on_windows_is_opened_through_directshow(on_windows):
    on_windows(["Built-in", "Desk", "Desk"], ["Desk", "Built-in", "Desk"])
    assert ways_to_open("0") == ["0", "dshow1"]
    assert ways_to_open("2") == ["2", "dshow2"]
    assert ways_to_open("0: Desk") == ["1", "dshow0"]
    assert ways_to_open("dshow2: Desk (DirectShow)") == ["dshow0"]
    assert ways_to_open("5") == ["5", "dshow5"]
    assert ways_to_open("http://phone/video") == ["http://phone/video"]


def test_other_systems_open_a_number_in_one_way_without_a_list(monkeypatch):
    monkeypatch.setattr(camera_list.sys, "platform", "darwin")
    monkeypatch.setattr(camera_list, "list_cameras", lambda: pytest.fail("it takes a second"))
    assert ways_to_open("3") == ["3"] and ways_to_open(__file__) == [__file__]


def test_a_list_is_made_in_the_background_and_kept_for_a_moment(monkeypatch):
    makers, made = [], [CameraName("0", "Built-in")]

    def listed() -> list[CameraName]:
        makers.append(threading.current_thread())
        return made

    monkeypatch.setattr(camera_list, "list_cameras", listed)
    cameras = CameraList()
    for _ in range(3):
        cameras.prepare()
    assert cameras.cameras(PATIENCE) == made and cameras.cameras(0.0) == made
    assert len(makers) == 1 and makers[0] is not threading.current_thread()
    monkeypatch.setattr(camera_list, "_FRESH", -1.0)
    assert cameras.cameras(PATIENCE) == made and len(makers) == 2


@needs_windows
def test_windows_names_its_cameras_in_both_interfaces():
    assert isinstance(windows_cameras.camera_names("Media Foundation"), list)
    assert isinstance(windows_cameras.camera_names("DirectShow"), list)


@needs_windows
@pytest.mark.skipif(not UNDER_WINE, reason="needs a place of the registry that programs may not change")
def test_directshow_names_are_those_of_the_registered_devices():
    import winreg

    names = {
        "{11111111-2222-3333-4444-555555555551}": "Caméra 测试",
        "{11111111-2222-3333-4444-555555555552}": "Second",
    }
    places = {
        name: rf"CLSID\{windows_cameras._VIDEO_INPUT}\Instance\{identifier}" for identifier, name in names.items()
    }
    try:
        for name, place in places.items():
            with winreg.CreateKey(winreg.HKEY_CLASSES_ROOT, place) as key:
                winreg.SetValueEx(key, "FriendlyName", 0, winreg.REG_SZ, name)
                winreg.SetValueEx(key, "CLSID", 0, winreg.REG_SZ, place.rpartition("\\")[2])
        assert set(names.values()) <= set(windows_cameras.camera_names("DirectShow"))
    finally:
        for place in places.values():
            winreg.DeleteKey(winreg.HKEY_CLASSES_ROOT, place)


@needs_windows
def test_privacy_settings_of_windows_are_named(monkeypatch):
    import winreg

    key = windows_cameras.CONSENT + "-test"
    monkeypatch.setattr(windows_cameras, "CONSENT", key)
    assert windows_cameras.why_refused() == ""
    try:
        with winreg.CreateKey(winreg.HKEY_CURRENT_USER, rf"{key}\{windows_cameras.DESKTOP_APPS}") as opened:
            winreg.SetValueEx(opened, "Value", 0, winreg.REG_SZ, "Deny")
        assert "Privacy & security > Camera" in windows_cameras.why_refused()
    finally:
        winreg.DeleteKey(winreg.HKEY_CURRENT_USER, rf"{key}\{windows_cameras.DESKTOP_APPS}")
        winreg.DeleteKey(winreg.HKEY_CURRENT_USER, key)


def test_an_edition_without_media_foundation_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(windows_cameras.sys, "platform", "win32")
    monkeypatch.setattr(windows_cameras, "_has_media_foundation", lambda: False, raising=False)
    assert "Media Feature Pack" in windows_cameras.missing_media_foundation()
    monkeypatch.setattr(windows_cameras, "_has_media_foundation", lambda: True)
    assert windows_cameras.missing_media_foundation() == ""


class Capture:
    """A camera of OpenCV that notes what it is asked for."""

    def __init__(self, backend: str, **given: float) -> None:
        self._backend, self.given, self.asked = backend, given, []

    def getBackendName(self) -> str:
        return self._backend

    def get(self, name: str) -> float:
        return self.given.get(name, 0.0)

    def set(self, name: str, value: float) -> bool:
        self.asked.append(name)
        return True


OPENCV = SimpleNamespace(
    CAP_PROP_FRAME_WIDTH="width",
    CAP_PROP_FRAME_HEIGHT="height",
    CAP_PROP_FPS="fps",
    CAP_PROP_FOURCC="fourcc",
    CAP_PROP_BUFFERSIZE="buffer",
    CAP_V4L2="v4l2",
    CAP_MSMF="msmf",
    CAP_DSHOW="dshow",
    CAP_AVFOUNDATION="avfoundation",
    CAP_ANY="any",
    VideoWriter_fourcc=lambda *_: 0,
    VideoCapture=lambda number, interface: (number, interface),
)


def test_media_foundation_is_asked_only_for_what_is_not_so_already():
    usual = Capture("MSMF", width=640, height=480, fps=30.0)
    camera_process.ask(OPENCV, usual, 640, 480, 30.0)
    assert usual.asked == []
    larger = Capture("MSMF", width=640, height=480, fps=29.97)
    camera_process.ask(OPENCV, larger, 1280, 720, 30.0)
    assert larger.asked == ["width", "height"]
    other = Capture("DSHOW", width=640, height=480, fps=30.0)
    camera_process.ask(OPENCV, other, 640, 480, 30.0)
    assert "fourcc" in other.asked


@pytest.mark.parametrize(
    ("platform", "device", "expected"),
    [
        ("win32", "1", (1, "msmf")),
        ("win32", "dshow2", (2, "dshow")),
        ("linux", "0", (0, "v4l2")),
        ("darwin", "0", (0, "avfoundation")),
    ],
)
def test_a_number_is_opened_in_the_interface_that_it_is_of(monkeypatch, platform, device, expected):
    monkeypatch.setattr(camera_process.sys, "platform", platform)
    number = camera_process.camera_number(device)
    assert camera_process.opened(OPENCV, device, number) == expected


def test_paths_and_addresses_are_no_numbers():
    for text in ("http://phone/video", "/dev/video0", "dshow", "dshow1.mp4", ""):
        assert camera_process.camera_number(text) is None


def test_hardware_transforms_are_off_before_opencv_is_loaded(tmp_path):
    seen = "OPENCV_VIDEOIO_MSMF_ENABLE_HW_TRANSFORMS"
    (tmp_path / "cv2.py").write_text(f"import os\nprint(os.environ.get({seen!r}), flush=True)\nos._exit(3)\n")
    line = [sys.executable, camera_process.__file__, str(tmp_path), "0", "640", "480", "30"]
    environment = {name: value for name, value in os.environ.items() if name != seen}
    with subprocess.Popen(line, env=environment, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stderr.read().strip() == b"0" and process.wait() == 3
