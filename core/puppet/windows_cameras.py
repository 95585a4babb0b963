"""Cameras on Windows: their names, in the order in which OpenCV numbers them, and why one cannot be used.

OpenCV opens a camera by its number in Media Foundation (`MFEnumDeviceSources`) or in DirectShow (`ICreateDevEnum`). The
orders may differ, and DirectShow also has virtual cameras that Media Foundation lacks.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import Message

CONSENT = r"Software\Microsoft\Windows\CurrentVersion\CapabilityAccessManager\ConsentStore\webcam"
"""Key of the registry with the privacy settings, for the computer and for the user."""
DESKTOP_APPS = "NonPackaged"
"""Key in it, for programs that are not from Microsoft's store."""


def camera_names(interface: str) -> list[str]:
    """Return the names of the cameras in "Media Foundation" or in "DirectShow", as OpenCV numbers them there.

    Raises OSError if the system does not tell.
    """
    if sys.platform == "win32":
        return _directshow_names() if interface == "DirectShow" else _media_foundation_names()
    raise OSError("an interface of Windows")


def missing_media_foundation() -> str:
    """Return what to install if this is an edition of Windows without Media Foundation, without which OpenCV does not
    load; otherwise "".
    """
    if sys.platform != "win32" or _has_media_foundation():
        return ""
    return Message(
        "This edition of Windows (N) lacks Media Foundation, which videos and cameras need. Install the Media Feature "
        "Pack under Settings > System > Optional features, and restart the computer."
    )


def why_refused() -> str:
    """Return what to change if Windows' privacy settings keep this program from using cameras; otherwise ""."""
    if sys.platform != "win32" or not _is_denied():
        return ""
    return Message(
        "Windows does not let programs use the camera. Turn on camera access, also for desktop apps, under Settings > "
        "Privacy & security > Camera."
    )


if sys.platform == "win32":
    import winreg

    # Methods of COM's objects, by their numbers in the tables of their interfaces.
    _RELEASE = 2
    _CREATE_CLASS_ENUMERATOR, _NEXT, _BIND_TO_STORAGE, _READ = 3, 3, 9, 3
    """Of ICreateDevEnum, IEnumMoniker, IMoniker and IPropertyBag."""
    _GET_ALLOCATED_STRING, _SET_GUID = 13, 24
    """Of IMFAttributes."""
    _IN_PROCESS = 1
    _MF_VERSION = 0x00020070
    _ENUMERATOR = "{62BE5D10-60EB-11D0-BD3B-00A0C911CE86}"
    _CREATE_ENUMERATOR = "{29840822-5B84-11D0-BD3B-00A0C911CE86}"
    _VIDEO_INPUT = "{860BB310-5D01-11D0-BD3B-00A0C911CE86}"
    _PROPERTY_BAG = "{55272A00-42CB-11CE-8135-00AA004BB851}"
    _SOURCE_TYPE = "{C60AC5FE-252A-478F-A0EF-BC8FA5F7CAD3}"
    _VIDEO_CAPTURE = "{8AC3587A-4AE7-42D8-99E0-0A6013EEF90F}"
    _FRIENDLY_NAME = "{60D0E559-52F8-4FA2-BBCE-ACDB34A8EC01}"

    class _Guid(ctypes.Structure):
        _fields_ = [("bytes", ctypes.c_byte * 16)]

    class _Variant(ctypes.Structure):
        _fields_ = [("kind", ctypes.c_ulonglong), ("text", ctypes.c_wchar_p), ("more", ctypes.c_void_p)]

    def _directshow_names() -> list[str]:
        with _components(), _held() as system, _held() as cameras:
            ask = ctypes.oledll.ole32.CoCreateInstance
            ask(_guid(_ENUMERATOR), None, _IN_PROCESS, _guid(_CREATE_ENUMERATOR), ctypes.byref(system))
            _call(system, _CREATE_CLASS_ENUMERATOR, _guid(_VIDEO_INPUT), ctypes.byref(cameras), 0)
            names = []
            while cameras:
                with _held() as camera, _held() as properties:
                    if _call(cameras, _NEXT, 1, ctypes.byref(camera), None):
                        break
                    try:
                        _call(camera, _BIND_TO_STORAGE, None, None, _guid(_PROPERTY_BAG), ctypes.byref(properties))
                    except OSError:  # OpenCV leaves it out, too
                        continue
                    names.append(_property(properties, "FriendlyName"))
            return names

    def _media_foundation_names() -> list[str]:
        with _components(), _held() as wanted:
            platform, listing = ctypes.oledll.mfplat, ctypes.oledll.mf
            platform.MFStartup(_MF_VERSION, 0)
            try:
                platform.MFCreateAttributes(ctypes.byref(wanted), 1)
                _call(wanted, _SET_GUID, _guid(_SOURCE_TYPE), _guid(_VIDEO_CAPTURE))
                cameras, count = ctypes.POINTER(ctypes.c_void_p)(), ctypes.c_uint()
                listing.MFEnumDeviceSources(wanted, ctypes.byref(cameras), ctypes.byref(count))
                names = [_attribute(ctypes.c_void_p(cameras[number])) for number in range(count.value)]
                ctypes.windll.ole32.CoTaskMemFree(cameras)
                return names
            finally:
                platform.MFShutdown()

    def _has_media_foundation() -> bool:
        try:
            return bool(ctypes.WinDLL("mfplat.dll") and ctypes.WinDLL("mf.dll"))
        except OSError:
            return False

    def _is_denied() -> bool:
        keys = [(place, key) for place in _PLACES for key in (CONSENT, rf"{CONSENT}\{DESKTOP_APPS}")]
        return any(_consent(place, key) == "Deny" for place, key in keys)

    _PLACES = (winreg.HKEY_LOCAL_MACHINE, winreg.HKEY_CURRENT_USER)

    def _consent(place: int, key: str) -> str:
        try:
            with winreg.OpenKey(place, key) as opened:
                return str(winreg.QueryValueEx(opened, "Value")[0])
        except OSError:  # not set
            return ""

    @contextmanager
    def _components() -> Iterator[None]:
        """Prepare COM for this thread, unless it already is, in any way."""
        prepared = ctypes.windll.ole32.CoInitializeEx(None, 0) >= 0
        try:
            yield
        finally:
            if prepared:
                ctypes.windll.ole32.CoUninitialize()

    @contextmanager
    def _held() -> Iterator[ctypes.c_void_p]:
        """Yield a place for an object of COM, which is released at the end."""
        place = ctypes.c_void_p()
        try:
            yield place
        finally:
            if place:
                _call(place, _RELEASE)

    def _call(instance: ctypes.c_void_p, number: int, *arguments: Any) -> int:
        """Call the method of an object of COM that has this number; raises OSError if it fails."""
        methods = ctypes.cast(instance, ctypes.POINTER(ctypes.POINTER(ctypes.c_void_p))).contents
        kinds = [ctypes.c_ulong if isinstance(argument, int) else ctypes.c_void_p for argument in arguments]
        status = ctypes.WINFUNCTYPE(ctypes.c_long, ctypes.c_void_p, *kinds)(methods[number])(instance, *arguments)
        if status < 0:
            raise ctypes.WinError(status)
        return int(status)

    def _guid(text: str) -> Any:
        made = _Guid()
        ctypes.oledll.ole32.CLSIDFromString(text, ctypes.byref(made))
        return ctypes.byref(made)

    def _property(bag: ctypes.c_void_p, name: str) -> str:
        value = _Variant()
        _call(bag, _READ, ctypes.c_wchar_p(name), ctypes.byref(value), None)
        text = str(value.text)
        ctypes.windll.oleaut32.VariantClear(ctypes.byref(value))
        return text

    def _attribute(camera: ctypes.c_void_p) -> str:
        """Return the name of a camera of Media Foundation, and release it."""
        try:
            text, length = ctypes.c_wchar_p(), ctypes.c_uint()
            _call(camera, _GET_ALLOCATED_STRING, _guid(_FRIENDLY_NAME), ctypes.byref(text), ctypes.byref(length))
            name = str(text.value)
            ctypes.windll.ole32.CoTaskMemFree(text)
            return name
        finally:
            _call(camera, _RELEASE)
