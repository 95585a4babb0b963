"""Frames per second that the user gives for files, most of which have times of their own."""

from __future__ import annotations

from ..errors import Message, SourceError

MIN_FPS, MAX_FPS = 1.0, 1000.0


def check_rate(fps: float | None) -> None:
    """Raise SourceError for a rate outside `MIN_FPS` to `MAX_FPS`."""
    if fps is not None and not MIN_FPS <= fps <= MAX_FPS:
        raise SourceError(
            "The rate cannot be {fps:g}. Use one between {low:g} and {high:g}.", fps=fps, low=MIN_FPS, high=MAX_FPS
        )


def unused_rate(fps: float | None) -> list[str]:
    """Return what to say about a rate that was given for a file with times of its own."""
    if fps is None:
        return []
    return [Message("The file has times of its own, so the rate of {fps:g} frames per second was not used.", fps=fps)]
