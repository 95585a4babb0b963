"""A catalogue of translations, as Blender ships them, that gives every text of Facemime another meaning."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

from tests.helpers.gui.window import ROOT

WRONG = "BLENDERS"
"""What the catalogue translates every text to."""
LANGUAGE = "zh_HANS"
_LANGUAGES = "0:Automatic:DEFAULT:100%\n1:English:en_US:100%\n13:Simplified Chinese:zh_HANS:100%\n"
"""Blender needs a language of number 1."""


def facemimes_texts() -> dict[str, str]:
    """Return Facemime's translations by English text."""
    return json.loads((ROOT / "assets" / "translations" / f"{LANGUAGE}.json").read_text(encoding="utf-8"))


def write_catalogue(folder: Path) -> None:
    """Write a catalogue, and the list of languages, to a folder `locale`, in place of those that are there."""
    place = folder / LANGUAGE / "LC_MESSAGES"
    place.mkdir(parents=True, exist_ok=True)
    listed, catalogue = folder / "languages", place / "blender.mo"
    for path in (listed, catalogue):
        path.unlink(missing_ok=True)  # they may be links to the files of another Blender
    listed.write_text(_LANGUAGES, encoding="utf-8")
    contexts = ("", "Operator\x04")
    texts = {f"{context}{text}": WRONG for text in facemimes_texts() for context in contexts}
    catalogue.write_bytes(_compiled({"": "Content-Type: text/plain; charset=UTF-8\n"} | texts))


def _compiled(texts: Mapping[str, str]) -> bytes:
    """Return the binary form of a catalogue, as gettext defines it."""
    pairs = sorted((key.encode(), value.encode()) for key, value in texts.items())
    start = 28 + 16 * len(pairs)
    keys, values, tables = b"", b"", []
    for key, _ in pairs:
        tables += [len(key), start + len(keys)]
        keys += key + b"\0"
    for _, value in pairs:
        tables += [len(value), start + len(keys) + len(values)]
        values += value + b"\0"
    head = struct.pack("<7I", 0x950412DE, 0, len(pairs), 28, 28 + 8 * len(pairs), 0, 28 + 16 * len(pairs))
    return head + struct.pack(f"<{len(tables)}I", *tables) + keys + values
