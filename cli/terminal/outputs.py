"""Outputs of a command: checked before the work begins, and claimed while it lasts."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from ...core.files.writing import check_distinct, check_writable, claimed

Outputs = Sequence[tuple[Path | None, Collection[str]]]


@contextlib.contextmanager
def outputs_of(outputs: Outputs, inputs: Mapping[str, Path | None], *more: Path) -> Iterator[None]:
    """Check the outputs of a command, and claim them for this process.

    Parameters
    ----------
    outputs : sequence of (Path or None, suffixes)
        Outputs that the user named, and their allowed suffixes.
    inputs : mapping of str to (Path or None)
        Inputs by their description, which must not be overwritten.

    Raises
    ------
    OutputError
        If an output cannot be written, is an input, or is being written by another process.
    """
    for path, suffixes in outputs:
        if path is not None:
            check_writable(path, suffixes)
    named = [path for path, _ in outputs if path is not None]
    check_distinct(named, inputs)
    with claimed(*named, *more):
        yield
