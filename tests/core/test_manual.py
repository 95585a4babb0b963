"""The pages that the extension ships: all their links are valid."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_SPEC = importlib.util.spec_from_file_location("manual", ROOT / "tools" / "manual.py")
manual = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(manual)


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The folder of the rendered pages."""
    manual.MANUAL = tmp_path_factory.mktemp("pages") / "manual"
    assert manual.main() == 0
    return manual.MANUAL


def test_links_pictures_and_anchors_of_all_pages_exist(pages):
    checked = 0
    for page in pages.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r'(?:href|src)="([^"]+)"', text):
            path, _, section = target.partition("#")
            if "://" in target:
                continue
            there = (page.parent / path).resolve() if path else page
            assert there.is_file(), (page.name, target)
            if section and there.suffix == ".html":
                assert f'id="{section}"' in there.read_text(encoding="utf-8"), (page.name, target)
            checked += 1
    assert checked > 60


def test_directives_of_the_site_are_left_out_and_tables_are_drawn(pages):
    assert "toctree" not in (pages / "index.html").read_text(encoding="utf-8")
    assert "<table>" in (pages / "guides" / "takes.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(("heading", "anchor"), [("4. Start the puppet", "start-the-puppet"), ("A `b` c", "a-b-c")])
def test_anchors_leave_numbers_out(heading, anchor):
    assert manual.anchor(heading) == anchor
