"""Takes as commands read them."""

from pathlib import Path

from ...core.capture import check_readable
from ...core.takes.file import load_take
from ...core.takes.take import Take
from .console import tell


def load_with_warnings(path: Path) -> Take:
    """The take at `path`; what its file has lost goes to standard error.

    Raises
    ------
    SourceError
        Where it cannot be read.
    """
    check_readable(path)
    take = load_take(path)
    if lost := take.info.get("recovered"):
        tell(f"facemime: {path}: {lost}")
    return take
