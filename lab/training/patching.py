"""Constants of the product with other values for a while, to measure or to leave out what they do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any


@contextmanager
def patched(values: Mapping[tuple[Any, str], Any]) -> Iterator[None]:
    """Give attributes of modules other values for a while."""
    before = {(module, name): getattr(module, name) for module, name in values}
    try:
        for (module, name), value in values.items():
            setattr(module, name, value)
        yield
    finally:
        for (module, name), value in before.items():
            setattr(module, name, value)
