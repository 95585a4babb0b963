"""Imports of what needs Blender's module, which the command may lack."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ...core.errors import FacemimeError
from .stopping import STOPPING


@contextmanager
def importing_blender(what: str, line: str = "...") -> Iterator[None]:
    """Import modules that need Blender within this context.

    Parameters
    ----------
    what : str
        What needs Blender: a command, an option or an input.
    line : str
        The command line to advise, after `facemime`.

    Raises
    ------
    FacemimeError
        If a module cannot be imported.
    """
    try:
        with STOPPING.importing():
            yield
    except ImportError as error:
        raise FacemimeError(
            "{what} needs Blender ({error}). Run: blender --command facemime {line}, or install bpy.",
            what=what,
            error=error,
            line=line,
        ) from error
