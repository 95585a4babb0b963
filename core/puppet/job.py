"""A job as a plain value: which face drives which head, how, and where the outputs go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..takes.file import SUFFIX
from .puppet_settings import PuppetSettings

CHARACTER_SUFFIXES = (
    *(".blend", ".glb", ".gltf", ".vrm", ".fbx", ".obj", ".abc"),
    *(".usd", ".usda", ".usdc", ".usdz", ".ply", ".stl", ".tri"),
)
"""Suffixes of files that can have a character."""


@dataclass(frozen=True)
class HeadFile:
    """The head called `name` in a .blend file or one of another program; "" for the only object with landmarks."""

    path: Path
    name: str = ""

    @property
    def is_character(self) -> bool:
        """Whether the file can have a character, by its suffix."""
        return self.path.suffix.lower() in CHARACTER_SUFFIXES


@dataclass(frozen=True)
class PuppetJob:
    """A head that is driven by a video or a take and written as an animation with pictures.

    Attributes
    ----------
    source : Path
        A video or a take.
    output : Path
        The .blend file to write; caches are written next to it.
    settings : PuppetSettings
        Settings. The key mapping and the path of the cache are set from `map` and `output` when the job runs.
    face : (float, float), optional
        Position of the face to track, as for `FaceTracker.choose`; by default the largest is tracked.
    head : HeadFile, optional
        The head; by default the built-in one.
    points, map : Path, optional
        Files with control points, and with the key mapping for "mapped" keys.
    style : Path, optional
        File with examples, which are added to those of the head.
    preview, sheet, gltf, take : Path, optional
        Further files to write: a video of performer and avatar, a contact sheet, the animated head as glTF, and the
        take.
    """

    source: Path
    output: Path
    settings: PuppetSettings = field(default_factory=PuppetSettings)
    face: tuple[float, float] | None = None
    head: HeadFile | None = None
    points: Path | None = None
    map: Path | None = None
    style: Path | None = None
    preview: Path | None = None
    sheet: Path | None = None
    gltf: Path | None = None
    take: Path | None = None

    @property
    def tracks(self) -> bool:
        """Whether the source has to be tracked."""
        return self.source.suffix.lower() != SUFFIX

    @property
    def inputs(self) -> Mapping[str, Path | None]:
        """Files to read, by their description."""
        return {
            "the video that is tracked" if self.tracks else "the take that moves the head": self.source,
            "the file of the head": None if self.head is None else self.head.path,
            "the file of the control points": self.points,
            "the key mapping": self.map,
            "the style": self.style,
        }

    @property
    def outputs(self) -> tuple[tuple[Path | None, frozenset[str]], ...]:
        """Files to write, and their allowed suffixes."""
        return (
            (self.output, frozenset({".blend"})),
            (self.preview, frozenset({".mp4"})),
            (self.sheet, frozenset({".png", ".jpg"})),
            (self.gltf, frozenset({".glb"})),
            (self.take, frozenset({SUFFIX})),
        )
