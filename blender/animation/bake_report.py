"""A bake before it is written, and what it reports to its user: keys, errors, keyframes and warnings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.drive.driver import HeadMotion
from ...core.errors import Message
from ...core.takes.neutral import Neutral
from ..fcurves import CharacterAction
from ..muting import Silenced, name_them

_POOR = 0.1
"""Error in eye distances above which the report says that keys cannot reproduce the motion."""


@dataclass(frozen=True)
class Plan:
    """A bake that was computed but not written yet.

    Attributes
    ----------
    keys : int
        Number of shape keys.
    error, named_error : float
        As in `PuppetReport`, in the unit of the mesh.
    write : callable
        Writes it, and returns what it muted.
    keyframes : int
        Number of keyframes of the shape keys.
    controls : int
        Number of controls, of which `keys` are the curves.
    """

    keys: int
    error: float
    write: Callable[[CharacterAction], list[Silenced]]
    named_error: float = float("nan")
    keyframes: int = 0
    controls: int = 0


@dataclass(frozen=True)
class PuppetReport:
    """Result of a bake.

    Attributes
    ----------
    keys : int
        Number of shape keys, or curves of controls; 0 for a cache.
    worst_error : float
        Largest error of a vertex in a frame, in outer-eye distances; NaN for a head that only its keys drive.
    named_error : float
        Error without the residual keys; NaN for a bake that has no such keys.
    keyframes, frames : int
        Number of keyframes of the shape keys, and that with one in each frame.
    others : tuple of str
        Other actions and NLA tracks that move shape keys of the character.
    start : float
        Frame of the scene at 0 s of the take.
    notes : tuple of str
        Further warnings.
    controls : int
        Number of controls of the character's own rig, if these are animated; `keys` is then that of their curves.
    """

    keys: int
    worst_error: float
    neutral: Neutral
    motion: HeadMotion
    named_error: float = float("nan")
    keyframes: int = 0
    frames: int = 0
    others: tuple[str, ...] = ()
    start: float = 1.0
    notes: tuple[str, ...] = ()
    controls: int = 0

    @property
    def warnings(self) -> list[str]:
        """Warnings for the user about the result."""
        warnings = [self.neutral.warning] if self.neutral.warning else []
        if self.others:
            names = ", ".join(self.others)
            warnings.append(
                Message("Other animation moves the shape keys too: {names}. Mute it in Takes > Bake.", names=names)
            )
        return [*warnings, *self.notes]

    def summary(self) -> str:
        """Return the number of shape keys, the error and the number of keyframes as text."""
        if not self.keys:
            return Message("exact for every vertex")
        if not 0 < self.keyframes < self.frames:
            return self._keys()
        times = f"{self.frames / self.keyframes:.1f}"
        curves = Message("{count} keyframes, {times} times fewer than frames", count=self.keyframes, times=times)
        return Message("{keys}; {curves}", keys=self._keys(), curves=curves)

    def _keys(self) -> Message:
        keys, error = self.keys, f"{100 * self.worst_error:.2g}"
        if self.controls:
            return Message(
                "{count} controls, largest error {error} % of the eye distance", count=self.controls, error=error
            )
        if np.isnan(self.worst_error):
            return Message("{keys} shape keys", keys=keys)
        if not np.isnan(self.named_error):
            named = f"{100 * self.named_error:.2g}"
            return Message(
                "{keys} shape keys, largest error {error} % of the eye distance ({named} % without the residual keys)",
                keys=keys,
                error=error,
                named=named,
            )
        if self.worst_error > _POOR:
            return Message(
                "{keys} shape keys, which cannot reproduce all of the motion: "
                "largest error {error} % of the eye distance",
                keys=keys,
                error=error,
            )
        return Message("{keys} shape keys, largest error {error} % of the eye distance", keys=keys, error=error)


def what_was_muted(silenced: Sequence[Silenced]) -> str:
    """Return a warning that names what was muted; an empty text if nothing was."""
    if not silenced:
        return ""
    names = name_them(silenced)
    return Message("Muted, as the take moves the same: {names}. Use Keep Animation to add the take to it.", names=names)
