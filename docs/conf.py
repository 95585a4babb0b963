"""Sphinx configuration: `make docs` builds these pages into build/docs, with every warning an error.

Three things differ from Sphinx's own.

Docstrings are numpydoc with single backquotes for code and formulas in plain text, where `|d|` is an absolute value and
`open_` a name: reStructuredText would look for a substitution and a link. Outside backquotes both are escaped.

Formulas are MathML, which every current browser draws by itself. Sphinx's own renderers load a script from somebody
else's server or need TeX. So a built page is complete: it can be read offline.

Every page reads well on a forge too, where a link to `../CONTRIBUTING.md` or `../core` opens the file or the folder. In
the built pages the documents of the project become pages of their own, below `project`, and a link to any other file of
the repository becomes its text alone.
"""

from __future__ import annotations

import re
import tomllib
from os.path import relpath
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PAGES = {
    ROOT / "CONTRIBUTING.md": DOCS / "project" / "contributing.md",
    ROOT / "CHANGELOG.md": DOCS / "project" / "changelog.md",
    ROOT / "SECURITY.md": DOCS / "project" / "security.md",
    ROOT / "assets" / "MODEL_CARD.md": DOCS / "project" / "model_card.md",
}
"""Documents of the project, and their pages."""
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?\)")
_CODE = re.compile(r"(`[^`]*`)")
_SPECIAL = re.compile(r"\||(?<=\w)_(?!\w)")

project = "Facemime"
copyright = "Facemime maintainers"
release = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
version = release

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
templates_path = ["_templates"]
exclude_patterns = ["_*", "**/_*", "release/*"]
default_role = "literal"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"
add_module_names = False
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
# Attributes are looked up by their bare names, which several classes may have.
suppress_warnings = ["ref.python"]

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"Facemime {release}"
html_theme_options = {"source_directory": "docs/", "navigation_with_keys": True}
html_copy_source = False
html_show_sphinx = False


def escape(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Escape what is no markup, in place; indented code blocks are not used in this project."""
    text = "\n".join(lines)
    parts = _CODE.split(text)
    parts[::2] = [_SPECIAL.sub(r"\\\g<0>", part) for part in parts[::2]]
    parts[1::2] = [f"``{' '.join(part[1:-1].split())}``" if part != "``" else part for part in parts[1::2]]
    lines[:] = "".join(parts).split("\n")


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on a line of its own."""
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def rewritten(text: str, file: Path, page: Path) -> str:
    """The text of `file` as that of `page`: its links lead to pages, or are left out."""

    def link(match: re.Match[str]) -> str:
        words, target, anchor = match[1], (file.parent / match[2]).resolve(), match[3] or ""
        target = PAGES.get(target, target)
        if target.is_relative_to(DOCS) or not target.exists():
            return f"[{words}]({relpath(target, page.parent)}{anchor})"
        return words

    return _LINK.sub(link, text)


def write_pages(app: Sphinx) -> None:
    """Copy the documents of the project into `docs/project`, which is not kept in the repository."""
    for file, page in PAGES.items():
        page.parent.mkdir(exist_ok=True)
        text = rewritten(file.read_text(encoding="utf-8"), file, page)
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def rewrite(app: Sphinx, name: str, source: list[str]) -> None:
    """Rewrite the links of a page, in place."""
    page = DOCS / f"{name}.md"
    if page.exists() and page not in PAGES.values():
        source[0] = rewritten(source[0], page, page)


def setup(app: Sphinx) -> None:
    """Escape docstrings before napoleon takes the sections apart, draw formulas, and rewrite links."""
    app.connect("autodoc-process-docstring", escape, priority=400)
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.connect("builder-inited", write_pages)
    app.connect("source-read", rewrite)
