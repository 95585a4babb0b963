"""Translation of messages, such as errors of `core`, which does not import Blender, and registration of translations.

Blender looks up constant texts. Of a message, the template is looked up, and the values are inserted into its
translation. `tools/strings.py` collects texts and templates from the sources.
"""

from __future__ import annotations

import json
from collections.abc import Callable

import bpy
from bpy.app.translations import pgettext_iface, pgettext_rpt, pgettext_tip

from ..core.errors import Message
from ..core.files.assets import ASSETS

FOLDER = ASSETS / "translations"
CONTEXT = "Facemime"
"""Translation context of our texts: without it Blender's own translations of the same words come first, which have
other meanings: Expression is a formula there, and Face a polygon."""


def load_languages() -> dict[str, dict[str, str]]:
    """Return the translations of each language, which is named as in Blender, by English text."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))}


def interface(text: str) -> str:
    """Translate a constant text of a panel or menu, in Facemime's context."""
    return pgettext_iface(text, CONTEXT)


def tooltip(text: str) -> str:
    """Translate a tooltip that depends on a button's properties; Blender translates only constant ones by itself."""
    return pgettext_tip(text, CONTEXT)


def translated(message: str, lookup: Callable[[str], str] | None = None) -> str:
    """Translate a message, and those among its values, to the language of Blender's interface.

    A message without a template is looked up itself. `lookup` is `interface` for labels; by default as for reports.
    Both respect the user's preferences.
    """
    lookup = lookup or _in_report
    if not isinstance(message, Message):
        return lookup(message)
    template = lookup(message.template)
    if not message.values:
        return template
    values = message.values.items()
    return template.format(**{k: translated(v, lookup) if isinstance(v, Message) else v for k, v in values})


def _in_report(text: str) -> str:
    return pgettext_rpt(text, CONTEXT)


def displayable(message: str) -> str:
    """Translate a message for a report, with bytes that are not UTF-8 escaped, as Blender requires."""
    return translated(message).encode(errors="backslashreplace").decode()


def show_error(message: str) -> None:
    """Show an error, translated, from a timer, where no operator can report it."""
    text = displayable(message)

    def draw(self: bpy.types.Menu, context: bpy.types.Context) -> None:
        self.layout.label(text=text, translate=False)

    if bpy.app.background:
        print(f"facemime: {text}")
    else:
        bpy.context.window_manager.popup_menu(draw, title="Facemime", icon="ERROR")


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
