"""Registration of Facemime's translations with Blender."""

from __future__ import annotations

import bpy

from ..blender.messages import CONTEXT, load_languages

_CONTEXTS = ("*", CONTEXT)


def texts() -> dict[str, dict[tuple[str, str], str]]:
    """Return the translations of each language, keyed by context and English text; tooltips have no context."""
    return {
        language: {(context, english): other for english, other in known.items() for context in _CONTEXTS}
        for language, known in load_languages().items()
    }


def register() -> None:
    """Register the translations."""
    bpy.app.translations.register(__package__, texts())  # type: ignore[arg-type]  # keyed by context and text


def unregister() -> None:
    """Unregister the translations."""
    bpy.app.translations.unregister(__package__)
