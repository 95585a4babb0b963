"""Translation of messages that contain values, such as errors of `core`, which does not import Blender.

Blender looks up constant texts. A message such as "head.tri cannot be read. Choose another file." is compared with the
templates in `assets/translations` instead ("{path} cannot be read. Choose another file."), and its values are inserted
into the translated template. `tools/strings.py` collects the templates from the sources.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from functools import lru_cache

import bpy
from bpy.app.translations import pgettext_iface, pgettext_rpt, pgettext_tip

from ..core.base.assets import ASSETS
from ..core.base.errors import Message

FOLDER = ASSETS / "translations"
CONTEXT = "Facemime"
"""Translation context of our texts: without it Blender's own translations of the same words come first, which have
other meanings: Expression is a formula there, and Face a polygon."""
NESTED = frozenset({"advice", "error", "kind", "kept", "label", "problem", "reason", "summary", "what", "where"})
"""Names of values that are texts, and are translated as well; other values are names, paths and numbers."""
_PLACEHOLDER = re.compile(r"\{([A-Za-z_]\w*)[^}]*\}")


class Templates:
    """Templates of messages, with the name of each value in braces.

    Parameters
    ----------
    texts : iterable of str
        Those without placeholders are ignored.
    """

    def __init__(self, texts: Iterable[str]) -> None:
        templates = [text for text in texts if _PLACEHOLDER.search(text)]
        # The more text a template contains, the more specific it is.
        templates.sort(key=lambda text: -len(_PLACEHOLDER.sub("", text)))
        self._patterns = [(text, re.compile(_pattern_of(text), re.DOTALL)) for text in templates]
        self.find = lru_cache(maxsize=256)(self._find)
        """As `_find`, cached: panels show the same messages in every redraw."""

    def translate(self, message: str, lookup: Callable[[str], str]) -> str:
        """Translate a message.

        Parameters
        ----------
        lookup : callable
            Returns the translation of a text or template, or the text itself if it has not been translated.

        Returns
        -------
        str
            The message itself if there is no translation.
        """
        if (constant := lookup(message)) != message or self._is_english(lookup):
            return constant
        if (found := self.find(message)) is None:
            return message
        template, values = found
        if (other := lookup(template)) == template:
            return message
        texts = {
            name: self.translate(value, lookup) if name.rstrip("0123456789") in NESTED else value
            for name, value in values.items()
        }
        return _PLACEHOLDER.sub(lambda match: texts[match[1]], other)

    def _is_english(self, lookup: Callable[[str], str]) -> bool:
        """Return whether not even the first template is translated, so that none has to be compared."""
        return all(lookup(text) == text for text, _ in self._patterns[:1])

    def _find(self, message: str) -> tuple[str, dict[str, str]] | None:
        """Return the most specific template that matches a message, with its values, or None if no template matches."""
        for text, pattern in self._patterns:
            if (match := pattern.fullmatch(message)) is not None:
                return text, match.groupdict()
        return None


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
    """Translate a message to the language of Blender's interface.

    Parameters
    ----------
    lookup : callable, optional
        `interface` for labels; by default as for reports. Both respect the user's preferences.
    """
    lookup = lookup or _in_report
    if not isinstance(message, Message):
        return _templates().translate(message, lookup)
    if not message.values:
        return lookup(message.template)
    values = {
        name: translated(value, lookup) if isinstance(value, Message) else value
        for name, value in message.values.items()
    }
    return lookup(message.template).format(**values)


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


@lru_cache(maxsize=1)
def _templates() -> Templates:
    return Templates({text: None for known in load_languages().values() for text in known})


def _pattern_of(text: str) -> str:
    parts = _PLACEHOLDER.split(text)
    literals, names = parts[::2], parts[1::2]
    pattern = re.escape(literals[0])
    for place, (name, literal) in enumerate(zip(names, literals[1:], strict=True)):
        pattern += (f"(?P={name})" if name in names[:place] else f"(?P<{name}>.*?)") + re.escape(literal)
    return pattern
