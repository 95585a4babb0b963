"""The claims of Yao, Li, Li & Su (2019), compared with measurements."""

from __future__ import annotations

from collections.abc import Mapping

from lab.bench.report import Table

_PAPERS, _DEEP, _WHOLE, _WIDE = "the paper's method", "with depth", "one function (proxy)", "one wide function"
_FULL = 0.95
"""Share of an opening above which it counts as full."""
_LITTLE = 1.1
"""Factor up to which an error counts as hardly greater."""
_CORRELATED, _RATE, _STARTING = 0.8, 24.0, 12

Claim = tuple[str, str, str, str]


def claims(tables: Mapping[str, Table]) -> Table:
    """Return a row per claim: its place, what the paper says, what is measured, and whether the claim holds.

    The tables are "errors", "openings", "clip", "labels", "greedy", "twelve", "speed" and "network" of
    `lab.bench.paper`, of which "labels" and "network" may be missing.
    """
    errors = tables["errors"]
    rows = [
        _less("figure 6", "three regions move a face more accurately than one function", errors, "all", _DEEP, _WHOLE),
        _points(tables["greedy"], tables["twelve"]),
        _expressions(tables["clip"], tables.get("labels")),
        *(_opening(tables["openings"], slit) for slit in ("mouth", "eyes")),
        _less(
            "figure 10", "three regions move the skin around the eyes more accurately", errors, "eyes", _DEEP, _WHOLE
        ),
        *(
            _less(
                "figure 11",
                f"more accurate than Laplacian deformation: {area}",
                errors,
                area,
                _DEEP,
                "bi-Laplacian editing",
            )
            for area in ("eyes", "brows", "lips", "cheeks", "jaw")
        ),
        _less("outlook", "the lack of depth is the main weakness", errors, "all", _DEEP, _PAPERS),
        _rate(tables["speed"]),
        *([_network(tables["network"])] if "network" in tables else []),
    ]
    return Table("Claims", ("place in the paper", "claim", "measurement", "confirmed"), rows)


def cell(table: Table, row: str, column: str) -> float:
    """A number in a table."""
    return float(str(next(each for each in table.rows if each[0] == row)[list(table.columns).index(column)]))


def _less(place: str, claim: str, errors: Table, area: str, one: str, other: str) -> Claim:
    """A claim that `one` has a smaller error than `other` in an area."""
    less, more = cell(errors, one, area), cell(errors, other, area)
    return place, claim, f"error {less:.2f} against {more:.2f}", _answer(less < more)


def _points(greedy: Table, twelve: Table) -> Claim:
    fewer = "12 of 20 in the upper region"
    grown = {area: (cell(twelve, "all 66", area), cell(twelve, fewer, area)) for area in ("eyes", "brows")}
    enough = [str(row[0]) for row in greedy.rows if int(str(row[2])) <= _STARTING]
    measured = "; ".join(
        f"error of the {area} {more:.2f} instead of {less:.2f}" for area, (less, more) in grown.items()
    )
    on_clip = f"enough for the clip at {' and '.join(enough)}" if enough else "never enough for the clip"
    little = all(more < _LITTLE * less for less, more in grown.values())
    return (
        "figures 7, 8",
        "12 of the 20 points of the upper region are enough",
        f"{measured}; {on_clip}",
        _part(little, bool(enough)),
    )


def _expressions(clip: Table, labels: Table | None) -> Claim:
    least = min(clip.rows, key=lambda row: float(str(row[1])))
    value = float(str(least[1]))
    measured, right = f"correlation with the true performer at least {value:.2f} ({least[0]})", value
    if labels is not None:
        right = cell(labels, "all", "pairs of frames in order")
        measured += f"; {right:.2f} of pairs of frames in the order of hand labels"
    return "figure 9", "common expressions are reproduced", measured, _part(value > _CORRELATED, right > _CORRELATED)


def _opening(openings: Table, slit: str) -> Claim:
    parts, best, wide = (cell(openings, row, slit) for row in (_PAPERS, _WHOLE, _WIDE))
    measured = f"{parts:.2f} of the true opening; one function {best:.2f}, a wide one {wide:.2f}"
    return (
        "figure 10",
        f"three regions open the {slit} fully; one function does not",
        measured,
        _answer(parts > _FULL > max(best, wide)),
    )


def _rate(speed: Table) -> Claim:
    rate = cell(speed, _PAPERS, "frames per second")
    return "section 5.1", "24 frames per second at 1,781 vertices", f"{rate:.0f} on one core", _answer(rate >= _RATE)


def _network(network: Table) -> Claim:
    delay, link = (cell(network, row, "ms") for row in ("frame to moved vertex, median", "delay of the network"))
    measured = f"{delay:.0f} ms after the frame, {link:.0f} of them in the network"
    return (
        "figures 12, 13",
        "a face tracked in one room moves an avatar in another",
        f"{measured}; an emulated headset, between two network namespaces",
        _answer(delay - link <= 1e3 / _RATE),
    )


def _answer(holds: bool) -> str:
    return "yes" if holds else "no"


def _part(*holds: bool) -> str:
    return "yes" if all(holds) else "partly" if any(holds) else "no"
