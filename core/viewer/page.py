"""The files of the page, and the headers that isolate it from other sites."""

from __future__ import annotations

import gzip
import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ..errors import ModelError
from ..files.assets import ASSETS
from ..files.reading import read_bytes

PAGE = ASSETS / "viewer"
BUILT = "built/viewer.js"
_MAX_BYTES = 16_000_000
_PARTS = {"viewer.js": BUILT, "viewer.css": "built/viewer.css", "icon.svg": "icon.svg"}
"""Files of the page by the names that it uses. Those in `built` are made by `tools/viewer.sh`."""
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_DIGEST = 8
"""Bytes of the digest in the name of a file that never changes."""


@dataclass(frozen=True)
class Content:
    """The content of a file, and the same compressed by gzip, if that is smaller; `kind` is the media type.

    It is `lasting` if the name contains a digest of the file, so that browsers may keep it.
    """

    kind: str
    data: bytes
    packed: bytes | None = None
    lasting: bool = False


def digest(*contents: bytes) -> str:
    """Return a name for contents that no others have."""
    found = hashlib.blake2b(digest_size=_DIGEST)
    for content in contents:
        found.update(len(content).to_bytes(8, "little"))
        found.update(content)
    return found.hexdigest()


@lru_cache(maxsize=1)
def page_files() -> dict[str, Content]:
    """Return the content of each file of the page, by its path below the token; raises ModelError if one is missing."""
    files, text = {}, _read(PAGE / "index.html")
    for name, place in _PARTS.items():
        data, (stem, suffix) = _read(PAGE / place), name.split(".")
        lasting = f"{stem}.{digest(data)}.{suffix}"
        text = text.replace(f'"{name}"'.encode(), f'"{lasting}"'.encode())
        files[lasting] = _content(name, data, lasting=True)
    files[""] = _content("index.html", text, lasting=False)
    return files


def security_headers(host: str, *, secure: bool) -> dict[str, str]:
    """Return the headers of every answer to a host, which was checked; `secure` is whether the request came by HTTPS.

    The page may only run its own scripts and talk to its own server, and no other site can embed it or learn its
    address.
    """
    socket = f"{'wss' if secure else 'ws'}://{host}"
    return {
        "Content-Security-Policy": f"{content_policy(socket)}; frame-ancestors 'none'",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }


def content_policy(socket: str) -> str:
    """Return the policy by which the page runs its own scripts only, and connects only to its server's WebSocket."""
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
        f"connect-src 'self' {socket}; base-uri 'none'; form-action 'none'"
    )


def _content(name: str, data: bytes, *, lasting: bool) -> Content:
    packed = gzip.compress(data, mtime=0)
    return Content(_TYPES[Path(name).suffix], data, packed if len(packed) < len(data) else None, lasting)


def _read(path: Path) -> bytes:
    try:
        return read_bytes(path, _MAX_BYTES)
    except (OSError, ValueError) as error:
        raise ModelError(
            "The viewer's page is incomplete: {path} cannot be read. Reinstall Facemime, or run make viewer.", path=path
        ) from error
