"""The claims of Yao, Li, Li & Su (2019) beside what is measured."""

from __future__ import annotations

from collections.abc import Mapping

from bench.report import Table

_PAPERS, _WHOLE, _WIDE = "the paper's way", "one function", "one wide function"
_PARTITION = "and soft borders"
_FULL = 0.95
"""Share of an opening from which it counts as full."""
_RATE = 24.0


def claims(tables: Mapping[str, Table]) -> Table:
    """A row for each claim: figure, what the paper says, what is measured, and whether it holds."""
    rows = [
        *_regions(tables),
        _points(tables["greedy"], tables["twelve"]),
        _expressions(tables["clip"]),
        *_openings(tables["openings"], tables["errors"]),
        *_areas(tables["errors"]),
        _depth(tables["errors"]),
        _rate(tables["speed"]),
    ]
    return Table("Claims", ("in the paper", "what it says", "what we measure", "holds"), rows)


def _cells(table: Table, name: str) -> dict[str, float]:
    row = next(row for row in table.rows if row[0] == name)
    return {str(column): value for column, value in zip(table.columns[1:], row[1:], strict=True)}  # type: ignore[misc]


def _answer(holds: bool) -> str:
    return "yes" if holds else "no"


def _regions(tables: Mapping[str, Table]) -> list[tuple[str, str, str, str]]:
    whole, parts = (_cells(tables["errors"], name)["all"] for name in (_WHOLE, "with depth"))
    said = f"error {parts:.2f} with three regions, {whole:.2f} with one"
    return [("figure 6", "a face is moved better in three regions than as one", said, _answer(parts < whole))]


def _points(greedy: Table, twelve: Table) -> tuple[str, str, str, str]:
    brows = [_cells(twelve, name) for name in ("all 66", "12 of 20 in the upper region")]
    upper = {row[0]: row[2] for row in greedy.rows}
    enough = [tolerance for tolerance, count in upper.items() if int(str(count)) <= 12]
    said = (
        f"eyes {brows[0]['eyes']:.2f} to {brows[1]['eyes']:.2f}, brows {brows[0]['brows']:.2f} to "
        f"{brows[1]['brows']:.2f}; on the sample clip 12 suffice for {', '.join(map(str, enough)) or 'no tolerance'}"
    )
    small = all(brows[1][area] < 1.1 * brows[0][area] for area in ("eyes", "brows"))
    return "figures 7, 8", "12 of the upper region's 20 points suffice", said, "yes" if small and enough else "partly"


def _expressions(clip: Table) -> tuple[str, str, str, str]:
    least = min(clip.rows, key=lambda row: float(str(row[1])))
    said = f"correlations of {float(str(least[1])):.2f} ({least[0]}) and more"
    return "figure 9", "common expressions are reproduced", said, _answer(float(str(least[1])) > 0.8)


def _openings(openings: Table, errors: Table) -> list[tuple[str, str, str, str]]:
    rows = []
    parts, best, wide = (_cells(openings, name) for name in (_PAPERS, _WHOLE, _WIDE))
    for slit in ("mouth", "eyes"):
        said = f"{parts[slit]:.2f} with regions, {best[slit]:.2f} with one function, {wide[slit]:.2f} with a wide one"
        holds = parts[slit] > _FULL and max(best[slit], wide[slit]) < _FULL
        rows.append(
            (
                "figure 10",
                f"with regions the {slit} open as far as they should, with one they do not",
                said,
                _answer(holds),
            )
        )
    rows[0] = ("figure 10", "with regions the mouth opens as far as it should, with one it does not", *rows[0][2:])
    one, three = (_cells(errors, name)["eyes"] for name in (_WHOLE, "with depth"))
    said = f"error {three:.2f} with regions, {one:.2f} with one function"
    return [*rows, ("figure 10", "with regions the skin around the eyes is right", said, _answer(three < one))]


def _areas(errors: Table) -> list[tuple[str, str, str, str]]:
    papers, laplacian = (_cells(errors, name) for name in ("with depth", "bi-Laplacian editing"))
    rows = []
    for area in ("eyes", "brows", "lips", "cheeks", "jaw"):
        said = f"error {papers[area]:.2f}, bi-Laplacian {laplacian[area]:.2f}"
        rows.append(
            (
                "figure 11",
                f"more exact than Laplacian deformation: {area}",
                said,
                _answer(papers[area] < laplacian[area]),
            )
        )
    return rows


def _depth(errors: Table) -> tuple[str, str, str, str]:
    flat, deep = (_cells(errors, name)["all"] for name in (_PAPERS, "with depth"))
    said = f"error {flat:.2f} without depth, {deep:.2f} with it"
    return "section 6", "the missing depth is the main weakness", said, _answer(deep < 0.8 * flat)


def _rate(speed: Table) -> tuple[str, str, str, str]:
    rate = _cells(speed, _PAPERS)["frames per second"]
    return "section 5.1", "24 frames per second at 1,781 vertices", f"{rate:.0f} on one core", _answer(rate >= _RATE)
