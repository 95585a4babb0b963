"""The files of the page, and the headers that isolate it from other sites."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import lru_cache
from pathlib import Path

from ..assets import ASSETS
from ..errors import ModelError
from ..reading import read_bytes

PAGE = ASSETS / "viewer"
_MAX_BYTES = 16_000_000
_OWN = ("viewer.css", "viewer.js", "avatar.js", "shaders.js", "stream.js", "room.js", "immersive.js", "texts.js")
_THREE = ("three/three.module.js", "three/three.core.js", "three/OrbitControls.js")
"""Built by `tools/viewer.sh`."""
_TYPES = {".html": "text/html; charset=utf-8", ".css": "text/css", ".js": "text/javascript"}
_IMPORT_MAP = re.compile(rb'<script type="importmap">(.*?)</script>', re.DOTALL)


@lru_cache(maxsize=1)
def page_files() -> dict[str, tuple[str, bytes]]:
    """Return the type and the content of each file of the page, by its path below the token.

    Raises
    ------
    ModelError
        If a file is missing.
    """
    return {"" if name == "index.html" else name: _file(PAGE / name) for name in ("index.html", *_OWN, *_THREE)}


def security_headers(host: str, *, secure: bool) -> dict[str, str]:
    """Return the headers of every answer.

    The page may only run its own scripts and talk to its own server, and no other site can embed it or learn its
    address.

    Parameters
    ----------
    host : str
        Host of the request, which was checked.
    secure : bool
        Whether the request came by HTTPS.

    Returns
    -------
    dict of str to str
        Headers by name.
    """
    scripts = f"'self' 'sha256-{_import_map_hash()}'"
    socket = f"{'wss' if secure else 'ws'}://{host}"
    return {
        "Content-Security-Policy": (
            f"default-src 'none'; script-src {scripts}; style-src 'self'; img-src 'self' blob:; "
            f"connect-src 'self' {socket}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        ),
        "Cache-Control": "no-store",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }


def _import_map_hash() -> str:
    found = _IMPORT_MAP.search(page_files()[""][1])
    return base64.b64encode(hashlib.sha256(b"" if found is None else found.group(1)).digest()).decode()


def _file(path: Path) -> tuple[str, bytes]:
    try:
        return _TYPES[path.suffix], read_bytes(path, _MAX_BYTES)
    except (OSError, ValueError) as error:
        raise ModelError(
            f"The viewer's page is incomplete: {path} cannot be read. Reinstall Facemime, or run make viewer."
        ) from error
