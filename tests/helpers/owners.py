"""Who can open a file, on any system; and whether Windows is wine, whose files are those of the system around it."""

import ctypes
import os
import re
import stat
import sys
from pathlib import Path

UNDER_WINE = sys.platform == "win32" and hasattr(ctypes.windll.ntdll, "wine_get_version")

_ACCESS_LIST = 4
_SYSTEM = "SY"
"""Windows itself, which can open any file."""


def who_can_open(path: Path) -> set[str]:
    """Return "owner", and whoever else can read or write a file."""
    if sys.platform != "win32":
        mode = stat.S_IMODE(path.stat().st_mode)
        return {"owner"} | {name for name, bits in (("group", 0o070), ("others", 0o007)) if mode & bits}
    from facemime.core.files.owner_only import own_identifier

    owner = own_identifier()
    allowed = re.findall(r"\(A;[^;]*;[^;]*;[^;]*;[^;]*;([^)]*)\)", _access_list(path))
    return {"owner" if name == owner else name for name in allowed} - {_SYSTEM}


def _access_list(path: Path) -> str:
    """Return who can do what with a file, in the language of security descriptors."""
    security = ctypes.WinDLL("advapi32")
    buffer, size, text = ctypes.create_string_buffer(1 << 16), ctypes.c_ulong(), ctypes.c_wchar_p()
    assert security.GetFileSecurityW(os.fspath(path), _ACCESS_LIST, buffer, len(buffer), ctypes.byref(size))
    convert = security.ConvertSecurityDescriptorToStringSecurityDescriptorW
    assert convert(buffer, 1, _ACCESS_LIST, ctypes.byref(text), None)
    return str(text.value)
