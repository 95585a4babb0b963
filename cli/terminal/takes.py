"""Loading of takes for commands."""

from pathlib import Path

from ...core.media.capture import check_readable
from ...core.takes.file import load_take
from ...core.takes.take import Take
from .console import tell


def load_with_warnings(path: Path) -> Take:
    """Load a take; what is missing from its file is reported on the standard error.

    Raises
    ------
    SourceError
        If it cannot be read.
    """
    check_readable(path)
    take = load_take(path)
    tell_what_is_missing(path, take)
    return take


def tell_what_is_missing(path: Path, take: Take) -> None:
    """Report on the standard error what could not be read of `path`, the file of a take or its video."""
    if lost := take.info.get("recovered"):
        tell(f"facemime: {path}: {lost}")
