"""Files that only their owner can read, even on Windows, where the mode of a new file has no such effect."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

if sys.platform == "win32":
    import msvcrt

    _GENERIC_WRITE = 0x40000000
    _CREATE_NEW = 1
    _NORMAL = 0x80
    _REVISION = 1
    _TOKEN_QUERY = 8
    _TOKEN_USER = 1
    _MAX_TOKEN = 256
    """Bytes of a user's identifier, which takes at most 68, and of the structure that points to it."""

    class _SecurityAttributes(ctypes.Structure):
        _fields_ = [("length", ctypes.c_ulong), ("descriptor", ctypes.c_void_p), ("inherit", ctypes.c_int)]

    def create(path: Path) -> int:
        """Create a file that only this user can open, and return its descriptor, for writing.

        Raises FileExistsError if it exists, and OSError if it cannot be created.
        """
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        kernel.CreateFileW.restype = ctypes.c_void_p
        kernel.LocalFree.argtypes = [ctypes.c_void_p]
        descriptor = _descriptor(f"D:P(A;;FA;;;{own_identifier()})")
        attributes = _SecurityAttributes(ctypes.sizeof(_SecurityAttributes), descriptor, 0)
        handle = kernel.CreateFileW(str(path), _GENERIC_WRITE, 0, ctypes.byref(attributes), _CREATE_NEW, _NORMAL, None)
        code = ctypes.get_last_error()
        kernel.LocalFree(descriptor)
        if handle == ctypes.c_void_p(-1).value:
            raise ctypes.WinError(code)
        return msvcrt.open_osfhandle(handle, os.O_WRONLY | os.O_BINARY | os.O_NOINHERIT)

    def _descriptor(text: str) -> ctypes.c_void_p:
        """Return a security descriptor from its text form, to be freed."""
        made = ctypes.c_void_p()
        convert = ctypes.WinDLL("advapi32", use_last_error=True).ConvertStringSecurityDescriptorToSecurityDescriptorW
        _check(convert(text, _REVISION, ctypes.byref(made), None))
        return made

    def own_identifier() -> str:
        """Return the identifier of this user, such as S-1-5-21-...-1001."""
        kernel, security = (ctypes.WinDLL(name, use_last_error=True) for name in ("kernel32", "advapi32"))
        kernel.GetCurrentProcess.restype = ctypes.c_void_p
        process, token = ctypes.c_void_p(kernel.GetCurrentProcess()), ctypes.c_void_p()
        _check(security.OpenProcessToken(process, _TOKEN_QUERY, ctypes.byref(token)))
        user, size = ctypes.create_string_buffer(_MAX_TOKEN), ctypes.c_ulong()
        text = ctypes.c_wchar_p()
        try:
            _check(security.GetTokenInformation(token, _TOKEN_USER, user, _MAX_TOKEN, ctypes.byref(size)))
            identifier = ctypes.c_void_p.from_buffer(user)
            _check(security.ConvertSidToStringSidW(identifier, ctypes.byref(text)))
        finally:
            kernel.CloseHandle(token)
        found = str(text.value)
        kernel.LocalFree(text)
        return found

    def _check(succeeded: int) -> None:
        if not succeeded:
            raise ctypes.WinError(ctypes.get_last_error())


def write_secret(path: Path, content: bytes, *, replace: bool = False) -> None:
    """Write a file that only its owner can read.

    Raises OSError if it cannot be written, and FileExistsError if it exists and `replace` is not set.
    """
    if sys.platform == "win32":
        if replace:
            path.unlink(missing_ok=True)
        descriptor = create(path)
    else:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if replace else os.O_EXCL), 0o600)
        os.fchmod(descriptor, 0o600)  # of a file that existed
    with open(descriptor, "wb") as file:
        file.write(content)
