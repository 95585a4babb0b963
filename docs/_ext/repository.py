"""Pages from files outside `docs`, and links to what is no page.

Every page reads well on a forge too, where a link to `../CONTRIBUTING.md` or `../core` opens the file or the folder. In
the built pages the documents of the project become pages of their own, below `project`, and a link to any other file of
the repository becomes its text alone.
"""

from __future__ import annotations

import re
from os.path import relpath
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
PAGES = {
    ROOT / "CONTRIBUTING.md": DOCS / "project" / "contributing.md",
    ROOT / "CHANGELOG.md": DOCS / "project" / "changelog.md",
    ROOT / "SECURITY.md": DOCS / "project" / "security.md",
    ROOT / "assets" / "MODEL_CARD.md": DOCS / "project" / "model_card.md",
}
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?![a-z]+:|#)([^)#\s]+)(#[^)\s]*)?\)")


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


def setup(app: Sphinx) -> dict[str, bool]:
    """Run before the pages are looked for, and on each that is read."""
    app.connect("builder-inited", write_pages)
    app.connect("source-read", rewrite)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
