"""`python -m lab.bench.docs`: copy tables of benchmarks from `build/bench` into `docs`.

A line `<!-- table: TITLE -->` in a document marks the table below it as the one that a benchmark prints under that
title; `git diff` then shows the changes. Tables without such a line are left alone.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_MARKER = re.compile(r"\s*<!-- table: (.+) -->\s*")
_TITLE = re.compile(r"## (.+)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Update the documents; return the exit status, 1 if there is no table, or a document lacks one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="*", type=Path, metavar="FILE.md", help="tables of benchmarks (build/bench)")
    parser.add_argument(
        "--docs", type=Path, default=ROOT / "docs", metavar="DIR", help="folder of the documents (docs)"
    )
    chosen = parser.parse_args(arguments)
    results = chosen.results or sorted((ROOT / "build" / "bench").glob("*.md"))
    tables = {title: lines for path in results for title, lines in tables_in(path.read_text("utf-8")).items()}
    if not tables:
        print("There are no tables. Run a benchmark first, such as make bench.", file=sys.stderr)
        return 1
    failed = False
    for path in sorted(chosen.docs.rglob("*.md")):
        before = path.read_text(encoding="utf-8")
        try:
            after, put_in = with_tables(before, tables)
        except ValueError as error:
            print(f"{path}: {error}", file=sys.stderr)
            failed = True
            continue
        if after != before:
            path.write_text(after, encoding="utf-8")
        if put_in:
            print(f"{path}: {', '.join(put_in)}")
    return int(failed)


def tables_in(text: str) -> dict[str, list[str]]:
    """Return the lines of each table by title; the last table if a title repeats."""
    tables: dict[str, list[str]] = {}
    title = ""
    for line in text.splitlines():
        if match := _TITLE.fullmatch(line):
            title = match[1]
            tables[title] = []
        elif title and line.startswith("|"):
            tables[title].append(line)
    return {title: lines for title, lines in tables.items() if lines}


def with_tables(text: str, tables: Mapping[str, Sequence[str]]) -> tuple[str, list[str]]:
    """Replace the tables that `text` marks; return the text, and the titles of these tables.

    Raises ValueError if a marker is not followed by a table.
    """
    found: list[str] = []
    put_in: list[str] = []
    lines = text.splitlines()
    while lines:
        found.append(lines.pop(0))
        if (match := _MARKER.fullmatch(found[-1])) is None:
            continue
        title, table = match[1], []
        while lines and lines[0].startswith("|"):
            table.append(lines.pop(0))
        if not table:
            raise ValueError(f"the table {title!r} is missing below its marker.")
        if title in tables:
            put_in.append(title)
        found += tables.get(title, table)
    return "\n".join(found) + "\n", put_in


if __name__ == "__main__":
    sys.exit(main())
