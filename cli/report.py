"""The report of a batch: report.json for programs, and report.html for people, a single file."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import cv2

from ..core.errors import SourceError
from ..core.files.capture import read_image
from ..core.files.writing import replacing

_SHEET_WIDTH = 480
"""Width of a contact sheet in pixels."""
_QUALITY = 75
"""Quality of JPEG, from 0 to 100."""
_CURVE_WIDTH = 300
"""Width of a confidence curve in pixels."""
_CURVE_HEIGHT = 48
"""Height of a confidence curve in pixels."""
_STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 2em; color: #222; background: #fafafa }
article { background: #fff; border: 1px solid #ddd; border-radius: 6px; padding: 1em; margin: 1em 0 }
article.failed { border-color: #b33 }
h2 { margin: 0 0 .3em; font-size: 1.1em; overflow-wrap: anywhere }
pre { white-space: pre-wrap; color: #922 } figure { display: inline-block; margin: .3em .6em .3em 0 }
img, svg { display: block; max-width: 100% } figcaption { color: #666; font-size: .85em }
"""


@dataclass(frozen=True)
class Entry:
    """A clip in the report, whose `status` is done, skipped (done before), failed or not reached."""

    clip: str
    status: str
    name: str = ""
    said: str = ""
    record: dict[str, Any] = field(default_factory=dict)


def write_report(entries: Sequence[Entry], folder: Path) -> None:
    """Write report.json and report.html into the output folder; raises OutputError if they cannot be written."""
    summary = {"counts": _counts(entries), "clips": [_without_pictures(entry) for entry in entries]}
    with replacing(folder / "report.json") as temporary:
        temporary.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    with replacing(folder / "report.html") as temporary:
        temporary.write_text(_page(entries, folder), encoding="utf-8", errors="replace")


def _counts(entries: Sequence[Entry]) -> dict[str, int]:
    return {
        status: sum(entry.status == status for entry in entries)
        for status in ("done", "skipped", "failed", "not reached")
    }


def _without_pictures(entry: Entry) -> dict[str, Any]:
    data = asdict(entry)
    data["record"].pop("thumbnails", None)
    return data


def _page(entries: Sequence[Entry], folder: Path) -> str:
    counts = ", ".join(f"{count} {status}" for status, count in _counts(entries).items() if count)
    # Failures first, then by the least confidence.
    body = "\n".join(_article(entry, folder) for entry in sorted(entries, key=_place))
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Facemime: {counts}</title>'
        f"<style>{_STYLE}</style></head>\n<body><h1>{len(entries)} clips: {counts}</h1>\n{body}\n</body></html>\n"
    )


def _place(entry: Entry) -> tuple[bool, float]:
    return entry.status != "failed", min(entry.record.get("confidence", ()), default=1.0)


def _article(entry: Entry, folder: Path) -> str:
    parts = [f"<h2>{escape(entry.clip)}: {escape(entry.status)}</h2>"]
    if entry.said:
        parts.append(f"<pre>{escape(entry.said)}</pre>")
    if record := entry.record:
        parts.append(
            f"<p>{record['length']:.1f} s, a face in {record['found']:d} of {record['frames']:d} frames, "
            f"processed in {record['seconds']:.1f} s</p>"
        )
        if missing := record.get("missing"):
            parts.append(f"<pre>{escape(missing)}</pre>")
        parts.append(_figure(_curve(record["confidence"]), "confidence over time, 0 to 1"))
        parts += [
            _figure(_image(picture), f"least certain, at {time:.2f} s")
            for picture, time in zip(record["thumbnails"], record["worst"], strict=False)
        ]
        parts.append(_figure(_image(_sheet(folder / f"{entry.name}.png")), "performer and avatar"))
    kind = ' class="failed"' if entry.status == "failed" else ""
    return f"<article{kind}>{''.join(parts)}</article>"


def _figure(content: str, caption: str) -> str:
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>" if content else ""


def _image(jpeg: str) -> str:
    return f'<img alt="" src="data:image/jpeg;base64,{escape(jpeg)}">' if jpeg else ""


def _curve(confidence: Sequence[float]) -> str:
    step = _CURVE_WIDTH / max(len(confidence) - 1, 1)
    points = " ".join(f"{i * step:.1f},{(1.0 - value) * _CURVE_HEIGHT:.1f}" for i, value in enumerate(confidence))
    return (
        f'<svg viewBox="0 -1 {_CURVE_WIDTH} {_CURVE_HEIGHT + 2}" width="{_CURVE_WIDTH}" height="{_CURVE_HEIGHT + 2}">'
        f'<rect width="{_CURVE_WIDTH}" height="{_CURVE_HEIGHT}" fill="#f0f0f0"/>'
        f'<polyline fill="none" stroke="#3a7d6b" points="{points}"/></svg>'
    )


def _sheet(path: Path) -> str:
    """The contact sheet, reduced, in base64; empty if it is missing."""
    try:
        image = read_image(path)
    except SourceError:
        return ""
    height = max(1, round(_SHEET_WIDTH * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, (_SHEET_WIDTH, height), interpolation=cv2.INTER_AREA)
    return base64.b64encode(jpeg_of(small)).decode()


def jpeg_of(image: Any) -> bytes:
    """Encode a picture, (H, W, 3) BGR, as JPEG."""
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])
