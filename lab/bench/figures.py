"""Figures of the tracking benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lab.bench.accuracy import LOST_ABOVE
from lab.bench.exact import AXES

_COLOURS = ("#1f6f5c", "#b5651d", "#5b6ea8", "#8c4a78")


def draw_tracking(path: Path, measured: dict[str, dict]) -> None:
    """Draw cumulative error curves, and the median error along every axis, of each tracker.

    `measured` is `lab.bench.tracking.measure` of each tracker, by its name.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplot_mosaic(
        [["photos", "photos", "all", "all"], *_rows(list(AXES))], figsize=(13.0, 12.5), layout="constrained"
    )
    for colour, (name, m) in zip(_COLOURS, measured.items(), strict=False):
        _cumulative(axes["photos"], m["photos"]["raw"], colour, name)
        pooled = [e for axis in m["axes"].values() for level in axis.values() for e in level["errors"]]
        _cumulative(axes["all"], pooled, colour, name)
        for axis, (_, values) in AXES.items():
            levels = [m["axes"][axis][str(value)] for value in values]
            axes[axis].plot(range(len(values)), [e["removed"] for e in levels], "o-", ms=3.5, color=colour)
    axes["photos"].set_title("Held-out people, labelled by hand, raw")
    axes["all"].set_title("All re-projected images, offsets removed")
    for name in ("photos", "all"):
        axes[name].set(xlim=(0, LOST_ABOVE), ylim=(0, 1), xlabel="error, % of the eye distance", ylabel="share")
    for axis, (unit, values) in AXES.items():
        words = any(isinstance(v, str) for v in values)
        axes[axis].set_xticks(range(len(values)), [str(v) for v in values], rotation=55 if words else 0, fontsize=8)
        axes[axis].set(ylim=(0, LOST_ABOVE), xlabel=unit)
        axes[axis].set_title(f"{axis}: median error, %", fontsize=10)
    for panel in axes.values():
        panel.grid(alpha=0.25)
        panel.spines[["top", "right"]].set_visible(False)
    axes["photos"].legend(loc="lower right", frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def _rows(names: list[str], columns: int = 4) -> list[list[str]]:
    return [names[i : i + columns] for i in range(0, len(names), columns)]


def _cumulative(panel: object, errors: list[float], colour: str, name: str) -> None:
    ordered = np.sort(errors)
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    panel.step([0.0, *ordered], [0.0, *share], where="post", color=colour, label=name)
