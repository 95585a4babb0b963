"""Parameters of which `make test` runs the first, and `make test-all` all."""

from collections.abc import Iterable
from typing import Any

import pytest


def first_of(values: Iterable[Any], quick: int = 1, *, rows: bool = False) -> list[Any]:
    """Mark all but the first `quick` values of a parameter as thorough; with `rows`, each value is one of several
    parameters.
    """
    values = list(values)
    rest = (value if rows else (value,) for value in values[quick:])
    return [*values[:quick], *(pytest.param(*row, marks=pytest.mark.thorough) for row in rest)]
