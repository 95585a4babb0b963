"""A job: which face moves which head, how, and where what comes of it goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..takes.file import SUFFIX
from .settings import PuppetSettings


@dataclass(frozen=True)
class HeadFile:
    """A head in a .blend: the object of this name, or where that is empty the only one with landmarks."""

    path: Path
    name: str = ""


@dataclass(frozen=True)
class PuppetJob:
    """A head that is moved by a video or by a take, as a file of animation and pictures of it.

    Attributes
    ----------
    source : Path
        A video, or a take.
    output : Path
        The .blend that is made; caches lie beside it.
    settings : PuppetSettings
        Its table and its cache's path come from `map` and `output` when the job is run.
    face : (float, float), optional
        Which of several faces is tracked, as for `FaceTracker.choose`; the largest by default.
    head : HeadFile, optional
        The built-in one by default.
    points, map : Path, optional
        Files of control points, and of the table for "mapped" keys.
    preview, sheet, take : Path, optional
        A video of performer and avatar, a contact sheet, and the take, where they are wanted.
    """

    source: Path
    output: Path
    settings: PuppetSettings = field(default_factory=PuppetSettings)
    face: tuple[float, float] | None = None
    head: HeadFile | None = None
    points: Path | None = None
    map: Path | None = None
    preview: Path | None = None
    sheet: Path | None = None
    take: Path | None = None

    @property
    def tracks(self) -> bool:
        """Whether the source has to be tracked."""
        return self.source.suffix.lower() != SUFFIX

    @property
    def inputs(self) -> Mapping[str, Path | None]:
        """What is read, by what it is."""
        return {
            "the video that is tracked" if self.tracks else "the take that moves the head": self.source,
            "the file of the head": None if self.head is None else self.head.path,
            "the file of the control points": self.points,
            "the table of keys": self.map,
        }

    @property
    def outputs(self) -> tuple[tuple[Path | None, frozenset[str]], ...]:
        """What is written, and what it may end in."""
        return (
            (self.output, frozenset({".blend"})),
            (self.preview, frozenset({".mp4"})),
            (self.sheet, frozenset({".png", ".jpg"})),
            (self.take, frozenset({SUFFIX})),
        )
