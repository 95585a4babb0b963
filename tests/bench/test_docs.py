"""Tables in documents are updated from benchmarks."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import pytest

from lab.bench import docs
from lab.bench.report import Table, finish

ROOT = Path(__file__).parents[2]
BEFORE = """# Speed
Some words.

<!-- table: Milliseconds -->
| stage | median |
|---|---|
| detect | 17 |
| track | 5 |

| what I measured by hand | |
|---|---|
| light | dim |
  <!-- table: Rates -->
| fps |
|---|
| 1 |
"""


@pytest.fixture
def folder(tmp_path):
    """A document, and the tables of a benchmark."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "speed.md").write_text(BEFORE, encoding="utf-8")
    tables = [
        Table("Milliseconds", ("stage", "median"), [("detect", 16.31), ("fit", 2.0), ("track", 4.868)]),
        Table("In no document", ("a",), [("b",)]),
    ]
    finish(argparse.Namespace(json=tmp_path / "speed.json"), tables, {"fps": 160})
    return tmp_path


def test_only_the_marked_tables_of_a_document_are_replaced(folder, capsys):
    capsys.readouterr()
    assert docs.main([str(folder / "speed.md"), "--docs", str(folder / "docs")]) == 0
    assert capsys.readouterr().out == f"{folder / 'docs' / 'speed.md'}: Milliseconds\n"
    rows = "| detect | 17 |\n| track | 5 |\n"
    after = BEFORE.replace(rows, "| detect | 16.3 |\n| fit | 2 |\n| track | 4.87 |\n")
    assert (folder / "docs" / "speed.md").read_text(encoding="utf-8") == after
    assert (folder / "speed.json").read_text() == '{\n  "fps": 160\n}\n'
    assert docs.main([str(folder / "speed.md"), "--docs", str(folder / "docs")]) == 0
    assert (folder / "docs" / "speed.md").read_text(encoding="utf-8") == after


def test_a_marker_without_a_table_is_reported_and_the_document_unchanged(folder, capsys):
    broken = BEFORE.replace("<!-- table: Milliseconds -->\n", "<!-- table: Milliseconds -->\n\n")
    (folder / "docs" / "speed.md").write_text(broken, encoding="utf-8")
    assert docs.main([str(folder / "speed.md"), "--docs", str(folder / "docs")]) == 1
    assert "the table 'Milliseconds' is missing" in capsys.readouterr().err
    assert (folder / "docs" / "speed.md").read_text(encoding="utf-8") == broken


def test_missing_results_are_reported_with_the_command_that_makes_them(folder, capsys):
    (folder / "empty.md").write_text("nothing", encoding="utf-8")
    assert docs.main([str(folder / "empty.md"), "--docs", str(folder / "docs")]) == 1
    assert "Run a benchmark first" in capsys.readouterr().err
    assert (folder / "docs" / "speed.md").read_text(encoding="utf-8") == BEFORE


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*.md")), ids=lambda path: path.name)
def test_all_markers_in_the_documents_are_valid(path):
    text = path.read_text(encoding="utf-8")
    assert docs.with_tables(text, {}) == (text, [])


PRIVATE = re.compile(
    r"\b(d6|d9|d10|d12|d18|rigged|vroid)\b|^<!-- table: .*(strangers|Expressions -->|artist's shapes|private)",
    re.MULTILINE,
)
"""Names of what `../shared/DATA.md` allows to be measured only, and titles of tables that come from it alone."""


def test_rows_from_private_data_are_marked_as_such():
    found = 0
    for path in sorted((ROOT / "docs" / "accuracy").glob("*.md")):
        for before, table in re.findall(r"([^\n]*\n\n)(<!-- table: .*-->\n(?:\|.*\n)+)", path.read_text("utf-8")):
            if PRIVATE.search(table):
                found += 1
                assert "private data" in (before + table.split("-->")[0]).lower(), (path.name, table.splitlines()[0])
    assert found >= 13
