"""Files that Blender writes either completely or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ...core.errors import OutputError
from ...core.files.writing import replacing
from .rendering import quiet


@contextmanager
def saved_by_blender(path: Path, is_complete: Callable[[Path], bool]) -> Iterator[str]:
    """Yield the path for Blender to write to, without output; an existing file is replaced only by a complete one.

    Parameters
    ----------
    is_complete : callable
        Whether the file at a path has its end: Blender does not notice a disk that becomes full at the very end.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.unlink()
        try:
            with quiet():
                yield str(temporary.resolve())
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[-1].removeprefix("Error: ")
            reason = reason[:1].lower() + reason[1:]
            raise OutputError(
                "Cannot write {path}: {reason}. Choose another location for the output.", path=path, reason=reason
            ) from error
        if not temporary.exists() or not is_complete(temporary):
            raise OutputError(
                "Cannot write {path}: no space is left. Choose another location for the output.", path=path
            )
