"""What the steps of a random sequence share: its files, its random numbers and the scene."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from facemime.core.takes.file import save_take
from tests.helpers.facegen_files import tri
from tests.helpers.takes import performance

Random = np.random.Generator


class Files:
    """Files that operators read, and where they write."""

    def __init__(self, folder: Path) -> None:
        self.take, self.blend, self.out = folder / "take.facetake", folder / "scene.blend", folder / "out"
        self.facegen = folder / "head.tri"
        self.out.mkdir(exist_ok=True)
        if not self.take.exists():
            save_take(performance(), self.take)
            self.facegen.write_bytes(tri())


class Stage:
    """State that the steps of a sequence share."""

    def __init__(self, files: Files, rng: Random) -> None:
        self.files, self.rng = files, rng

    def any_of(self, things):
        """Choose one item, or None if there are no items."""
        things = list(things)
        return things[self.rng.integers(len(things))] if things else None

    def active(self) -> bpy.types.Object | None:
        """The active object."""
        return bpy.context.active_object

    def mesh(self) -> bpy.types.Mesh | None:
        """The mesh of the active object, if it can be changed."""
        obj = self.active()
        return obj.data if obj is not None and obj.type == "MESH" and bpy.context.mode == "OBJECT" else None
