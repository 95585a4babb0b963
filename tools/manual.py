"""Render the guides in docs/ as pages that ship with the extension, so that its links to them work offline."""

from __future__ import annotations

import html
import re
import shutil
import sys
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[1]
DOCS, MANUAL = ROOT / "docs", ROOT / "manual"
_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width">
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 16px/1.55 system-ui, sans-serif; max-width: 52rem; margin: 2rem auto; padding: 0 1rem; }}
img {{ max-width: 100%; }}
pre {{ overflow-x: auto; padding: .8rem; background: #8881; }}
table {{ border-collapse: collapse; }}
th, td {{ padding: .25rem .7rem; border-bottom: 1px solid #8885; text-align: left; }}
</style></head><body>
<nav><a href="{home}">Facemime</a></nav>
{body}
</body></html>
"""
_ROOMS = ("tutorials", "guides", "reference", "accuracy")
_DIRECTIVE = re.compile(r"^```\{.*?^```\n", re.DOTALL | re.MULTILINE)


def main() -> int:
    """Render into `manual/`; return the exit status."""
    shutil.rmtree(MANUAL, ignore_errors=True)
    pages = [*DOCS.glob("*.md"), *(page for room in _ROOMS for page in (DOCS / room).glob("*.md"))]
    for page in pages:
        target = MANUAL / page.relative_to(DOCS).with_suffix(".html")
        target.parent.mkdir(parents=True, exist_ok=True)
        home = "index.html" if page.parent == DOCS else "../index.html"
        target.write_text(render(page, home), encoding="utf-8")
    for picture in {picture for page in pages for picture in pictures(page)}:
        target = MANUAL / picture.relative_to(DOCS)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, target)
    return 0


def anchor(heading: str) -> str:
    """Return the anchor of a heading, as the documentation's site makes it: without a number in front."""
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).lstrip("-0123456789").rstrip("-")


def _written_anchor(heading: str) -> str:
    """Return the anchor of a heading by which pages refer to it, as code hosts make it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def pictures(page: Path) -> list[Path]:
    """Return the pictures of a page that exist."""
    found = re.findall(r"!\[[^\]]*\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
    return [path for name in found if (path := (page.parent / name).resolve()).is_file() and path.is_relative_to(DOCS)]


def render(page: Path, home: str) -> str:
    """Render a page.

    Parameters
    ----------
    page : Path
        Markdown; directives of the site are left out.
    home : str
        Relative address of the first page.
    """
    parser = MarkdownIt("commonmark").enable("table")
    tokens = parser.parse(_DIRECTIVE.sub("", page.read_text(encoding="utf-8")))
    title = "Facemime"
    for token, following in zip(tokens, [*tokens[1:], Token("", "", 0)], strict=True):
        if token.type == "heading_open":
            token.attrSet("id", anchor(following.content))
            written = Token("html_inline", "", 0, content=f'<a id="{_written_anchor(following.content)}"></a>')
            following.children = [written, *(following.children or ())]
            title = following.content if token.tag == "h1" else title
        for part in token.children or ():
            if part.type == "link_open":
                part.attrSet("href", _address(page, str(part.attrGet("href"))))
    body = parser.renderer.render(tokens, parser.options, {})
    return _PAGE.format(title=html.escape(title), home=home, body=body)


def _address(page: Path, address: str) -> str:
    """Return the address of a link: pages that come along are linked, other files of the repository are not."""
    path, hash_, section = address.partition("#")
    if "://" in address or not path:
        return address
    there = (page.parent / path).resolve().is_relative_to(DOCS) and path.endswith(".md")
    return path.removesuffix(".md") + ".html" + hash_ + section if there else ""


if __name__ == "__main__":
    sys.exit(main())
