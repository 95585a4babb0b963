"""What a command writes: looked at before the work begins, and its own while that lasts."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from ...core.files import check_distinct, check_writable, claimed

Outputs = Sequence[tuple[Path | None, Collection[str]]]


@contextlib.contextmanager
def outputs_of(outputs: Outputs, inputs: Mapping[str, Path | None], *more: Path) -> Iterator[None]:
    """Keep the outputs of a command to this process.

    Parameters
    ----------
    outputs : sequence of (Path or None, suffixes)
        Those that the user named, and what they may end in.
    inputs : mapping of str to (Path or None)
        What is read, by what it is; never written over.
    more : Path
        What else is written.

    Raises
    ------
    OutputError
        Where one cannot be written, is an input, or is being written by another process.
    """
    for path, suffixes in outputs:
        if path is not None:
            check_writable(path, suffixes)
    named = [path for path, _ in outputs if path is not None]
    check_distinct(named, inputs)
    with claimed(*named, *more):
        yield
