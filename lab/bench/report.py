"""Tables, figures and JSON of benchmarks."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.training.data import add_data_option


@dataclass(frozen=True)
class Table:
    """A titled table; `rows` hold text and numbers, one per column."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def markdown(self) -> str:
        """The table as Markdown, numbers with three significant digits."""
        lines = [
            f"## {self.title}",
            "",
            "| " + " | ".join(self.columns) + " |",
            "|" + "---|" * len(self.columns),
        ]
        lines += ["| " + " | ".join(_text(value) for value in row) + " |" for row in self.rows]
        return "\n".join(lines) + "\n"


def parser(description: str) -> argparse.ArgumentParser:
    """Add the arguments common to all benchmarks."""
    arguments = argparse.ArgumentParser(description=description)
    arguments.add_argument(
        "--json", type=Path, metavar="FILE", help="write the numbers, and the tables beside it as .md"
    )
    arguments.add_argument("--figure", type=Path, metavar="FILE.png", help="write the figure")
    return arguments


def people_parser(description: str, people: int) -> argparse.ArgumentParser:
    """Add the arguments of benchmarks that render `people` from photos, unless another number is given."""
    arguments = parser(description)
    add_data_option(arguments)
    arguments.add_argument("--people", type=int, default=people, help=f"number of people ({people})")
    return arguments


def bars(path: Path, title: str, names: Sequence[str], values: Sequence[float], unit: str) -> None:
    """Draw horizontal bars, one per name, labelled with their values."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 0.5 + 0.4 * len(names)), layout="constrained")
    drawn = axes.barh(range(len(names)), values, color="#3a7d6b")
    axes.bar_label(drawn, [_text(value) for value in values], padding=3)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set_xlabel(unit)
    axes.set_title(title)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.12)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def finish(arguments: argparse.Namespace, tables: Sequence[Table], numbers: dict[str, object]) -> None:
    """Print the tables; if requested, write JSON, with the tables beside it for `lab.bench.docs`."""
    printed = "\n".join(table.markdown() for table in tables)
    print(printed)
    if arguments.json is not None:
        arguments.json.with_suffix(".md").write_text(printed, encoding="utf-8")
        arguments.json.write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
