"""Docstrings as they are written here, read as reStructuredText.

They are numpydoc with single backquotes for code and formulas in plain text, where `|d|` is an absolute value and
`open_` a name: reStructuredText would look for a substitution and a link. Outside backquotes both are escaped.
"""

from __future__ import annotations

import re

from sphinx.application import Sphinx

_CODE = re.compile(r"(`[^`]*`)")
_SPECIAL = re.compile(r"\||(?<=\w)_(?!\w)")


def escape(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Escape what is no markup, in place; indented code blocks are not used in this project."""
    text = "\n".join(lines)
    parts = _CODE.split(text)
    parts[::2] = [_SPECIAL.sub(r"\\\g<0>", part) for part in parts[::2]]
    parts[1::2] = [f"``{' '.join(part[1:-1].split())}``" if part != "``" else part for part in parts[1::2]]
    lines[:] = "".join(parts).split("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Run before napoleon, which takes the sections apart."""
    app.connect("autodoc-process-docstring", escape, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
