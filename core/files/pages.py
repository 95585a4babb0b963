"""Pages of HTML for reports: a frame with a style of its own, and pictures."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from typing import Any

import cv2

_QUALITY = 80
"""Quality of JPEG, from 0 to 100."""
_STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 2em; color: #222; background: #fafafa }
article { background: #fff; border: 1px solid #ddd; border-radius: 6px; padding: 1em; margin: 1em 0 }
article.failed { border-color: #b33 }
article h2, article h3 { margin: 0 0 .3em; font-size: 1.1em; overflow-wrap: anywhere }
small { color: #666; font-weight: normal }
table { border-collapse: collapse } td { padding: .2em 1em .2em 0; vertical-align: top }
pre { white-space: pre-wrap; color: #922 }
figure { display: inline-block; margin: .3em .6em .3em 0; vertical-align: top }
img, svg { display: block; max-width: 100% } figcaption { color: #666; font-size: .85em }
"""


def html_page(title: str, heading: str, body: Iterable[str]) -> str:
    """Return a page; `title` and `heading` are text, and the parts of `body` are HTML."""
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head>\n<body><h1>{escape(heading)}</h1>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def jpeg_of(image: Any) -> bytes:
    """Encode a picture, (H, W, 3) BGR, as JPEG."""
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])


def inline_jpeg(jpeg: bytes) -> str:
    """Return the address of a JPEG file that is within the page."""
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
