"""The report of a batch: report.json for programs, and report.html for people.

Up to a hundred clips, the page is a single file, which can be shared. For more, it is a summary with links to pages of
a hundred clips each, whose pictures are files. Pages are written while the batch runs, and records are read one by one,
so that the memory does not grow with the number of clips.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2

from ..core.errors import OutputError
from ..core.files.pages import html_page, inline_jpeg, jpeg_of
from ..core.files.writing import replacing
from .clips import PICTURES, Clip, read_record

STATUSES = ("done", "skipped", "failed", "not reached")
_ON_PAGE = 100
"""Clips on a page."""
_DOUBTFUL = 50
"""Least certain clips that a summary lists."""
_INTERVAL = 15.0
"""Seconds between two versions of a page, unless all of its clips have ended."""
_SHEET_WIDTH = 480
"""Width of a contact sheet in pixels."""
_CURVE_WIDTH = 300
"""Width of a confidence curve in pixels."""
_CURVE_HEIGHT = 48
"""Height of a confidence curve in pixels."""


@dataclass(frozen=True)
class Entry:
    """A clip in the report, whose `status` is done, skipped (done before), failed or not reached.

    `name` is that of its outputs, "" if it cannot be read, and `least` the smallest confidence, 1 if it is not done.
    """

    clip: str
    status: str
    name: str = ""
    said: str = ""
    least: float = 1.0


class Report:
    """The report of a batch, which is written as clips end.

    Parameters
    ----------
    entries : sequence of Entry
        All clips, as they are at the start.
    folder : Path
        The output folder, which has the records.
    """

    def __init__(self, entries: Sequence[Entry], folder: Path) -> None:
        self._entries, self._folder = list(entries), folder
        self._written = [0.0] * len(self._pages)
        self._waiting = set(range(len(self._written)))

    @property
    def _pages(self) -> list[Sequence[Entry]]:
        return [self._entries[start : start + _ON_PAGE] for start in range(0, len(self._entries), _ON_PAGE)]

    def ended(self, number: int, entry: Entry) -> None:
        """Note what became of a clip, and write its page if that was last done some time ago, or all have ended.

        A page that cannot be written is written by `finish`, so that the other clips are still processed.
        """
        self._entries[number] = entry
        page = number // _ON_PAGE
        self._waiting.add(page)
        complete = all(each.status != "not reached" for each in self._pages[page])
        if complete or time.monotonic() - self._written[page] > _INTERVAL:
            try:
                self._write(page)
                self._write_summary()
            except (OSError, OutputError):
                self._waiting.add(page)

    def finish(self) -> None:
        """Write the report; raises OutputError if it cannot be written."""
        for page in sorted(self._waiting):
            self._write(page)
        self._write_summary()
        with replacing(self._folder / "report.json") as temporary, temporary.open("w", encoding="utf-8") as stream:
            stream.write(f'{{"counts": {json.dumps(_counts(self._entries))},\n"clips": [')
            for number, entry in enumerate(self._entries):
                data = {**asdict(entry), "record": _record(entry, self._folder)}
                stream.write(("," if number else "") + "\n" + json.dumps(data))
            stream.write("\n]}\n")

    def _write(self, page: int) -> None:
        """Write a page of clips; a single one is the whole report."""
        self._written[page] = time.monotonic()
        self._waiting.discard(page)
        single, entries = len(self._written) == 1, self._pages[page]
        body = [_article(entry, self._folder, inline=single) for entry in sorted(entries, key=_place)]
        if single:
            _write_page(self._folder / "report.html", _title(entries), body)
        else:
            (self._folder / PICTURES).mkdir(exist_ok=True)
            back = f'<p><a href="../report.html">All {len(self._entries)} clips</a></p>'
            _write_page(self._folder / PICTURES / _page_name(page), _title(entries), [back, *body])

    def _write_summary(self) -> None:
        if len(self._written) == 1:
            return
        failed = [(number, entry) for number, entry in enumerate(self._entries) if entry.status == "failed"]
        order = sorted(range(len(self._entries)), key=lambda number: self._entries[number].least)
        doubtful = [
            (number, self._entries[number]) for number in order[:_DOUBTFUL] if self._entries[number].least < 1.0
        ]
        body = []
        if failed:
            body += [
                "<h2>Failed</h2>",
                _table((_link(n, entry), escape(_last_line(entry.said))) for n, entry in failed),
            ]
        if doubtful:
            least = _table((_link(n, entry), f"{entry.least:.2f}") for n, entry in doubtful)
            body += ["<h2>Least certain: smallest confidence, 0 to 1</h2>", least]
        links = (
            f'<a href="{PICTURES}/{_page_name(page)}">{page * _ON_PAGE + 1} to {page * _ON_PAGE + len(entries)}</a>'
            if self._written[page]
            else f"{page * _ON_PAGE + 1} to {page * _ON_PAGE + len(entries)}"
            for page, entries in enumerate(self._pages)
        )
        body += ["<h2>Pages</h2>", _table(zip(links, map(_said_counts, self._pages), strict=True))]
        _write_page(self._folder / "report.html", _title(self._entries), body)


def _page_name(page: int) -> str:
    return f"page-{page + 1}.html"


def _link(number: int, entry: Entry) -> str:
    return f'<a href="{PICTURES}/{_page_name(number // _ON_PAGE)}#{_quoted(entry.name)}">{escape(entry.clip)}</a>'


def _quoted(name: str) -> str:
    return quote(name, errors="replace")


def _table(rows: Iterable[tuple[str, str]]) -> str:
    return "<table>" + "\n".join(f"<tr><td>{one}</td><td>{other}</td></tr>" for one, other in rows) + "</table>"


def _last_line(said: str) -> str:
    return (said.splitlines() or [""])[-1].removeprefix("facemime: ")


def _counts(entries: Sequence[Entry]) -> dict[str, int]:
    counted = Counter(entry.status for entry in entries)
    return {status: counted[status] for status in STATUSES}


def _said_counts(entries: Sequence[Entry]) -> str:
    return ", ".join(f"{count} {status}" for status, count in _counts(entries).items() if count)


def _title(entries: Sequence[Entry]) -> str:
    return f"{len(entries)} clips: {_said_counts(entries)}"


def _write_page(path: Path, title: str, body: Sequence[str]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(html_page(f"Facemime: {title}", title, body), encoding="utf-8", errors="replace")


def _place(entry: Entry) -> tuple[bool, float]:
    """Failures first, then by the least confidence."""
    return entry.status != "failed", entry.least


def _record(entry: Entry, folder: Path) -> dict[str, Any]:
    """The record of a clip; empty if it is not done."""
    return (read_record(Clip(Path(entry.clip), entry.name), folder) if entry.name else None) or {}


def _article(entry: Entry, folder: Path, *, inline: bool) -> str:
    parts = [f"<h2>{escape(entry.clip)}: {escape(entry.status)}</h2>"]
    if entry.said:
        parts.append(f"<pre>{escape(entry.said)}</pre>")
    if record := _record(entry, folder):
        parts.append(
            f"<p>{record['length']:.1f} s, a face in {record['found']:d} of {record['frames']:d} frames, "
            f"processed in {record['seconds']:.1f} s</p>"
        )
        if missing := record.get("missing"):
            parts.append(f"<pre>{escape(missing)}</pre>")
        parts.append(_figure(_curve(record["confidence"]), "confidence over time, 0 to 1"))
        captions = [*(f"least certain, at {time:.2f} s" for time in record["worst"]), "performer and avatar"]
        parts += [
            _figure(_image(folder / PICTURES / picture, inline=inline), caption)
            for picture, caption in zip(record["pictures"], captions, strict=False)
        ]
    kind = ' class="failed"' if entry.status == "failed" else ""
    return f'<article id="{_quoted(entry.name)}"{kind}>{"".join(parts)}</article>'


def _figure(content: str, caption: str) -> str:
    return f"<figure>{content}<figcaption>{escape(caption)}</figcaption></figure>" if content else ""


def _image(path: Path, *, inline: bool) -> str:
    """A picture in the page itself, or as a link to its file; empty if it is missing."""
    try:
        source = inline_jpeg(path.read_bytes()) if inline else _quoted(path.name)
    except OSError:
        return ""
    return f'<img alt="" loading="lazy" src="{source}">'


def _curve(confidence: Sequence[float]) -> str:
    step = _CURVE_WIDTH / max(len(confidence) - 1, 1)
    points = " ".join(f"{i * step:.1f},{(1.0 - value) * _CURVE_HEIGHT:.1f}" for i, value in enumerate(confidence))
    return (
        f'<svg viewBox="0 -1 {_CURVE_WIDTH} {_CURVE_HEIGHT + 2}" width="{_CURVE_WIDTH}" height="{_CURVE_HEIGHT + 2}">'
        f'<rect width="{_CURVE_WIDTH}" height="{_CURVE_HEIGHT}" fill="#f0f0f0"/>'
        f'<polyline fill="none" stroke="#3a7d6b" points="{points}"/></svg>'
    )


def sheet_for_report(image: Any) -> bytes:
    """Reduce a contact sheet, (H, W, 3) BGR, to the width of the report, as JPEG."""
    height = max(1, round(_SHEET_WIDTH * image.shape[0] / image.shape[1]))
    return jpeg_of(cv2.resize(image, (_SHEET_WIDTH, height), interpolation=cv2.INTER_AREA))
