"""Facemime's texts in other languages, for Blender to look up as it does its own."""

from __future__ import annotations

import json

import bpy

from ..core.assets import ASSETS

FOLDER = ASSETS / "translations"
_CONTEXTS = ("*", "Operator")


def texts() -> dict[str, dict[tuple[str, str], str]]:
    """What is to be said in each language, by context and English text; the files are named as Blender's languages."""
    return {
        path.stem: {
            (context, english): other
            for english, other in json.loads(path.read_text(encoding="utf-8")).items()
            for context in _CONTEXTS
        }
        for path in sorted(FOLDER.glob("*.json"))
    }


def register() -> None:
    """Make the languages known."""
    bpy.app.translations.register(__package__, texts())


def unregister() -> None:
    """Forget them."""
    bpy.app.translations.unregister(__package__)
