"""Speed and accuracy of bakes to keys and to caches; part of `python -m bench.takes`."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from bench.live import dense_head
from bench.report import Table
from facemime.blender.actions import Curve, write_curves
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.built_in import add_head
from facemime.core.bake.arkit import COEFFICIENTS
from facemime.core.bake.settings import BakeSettings
from facemime.core.puppet.settings import PuppetSettings
from facemime.core.takes.take import Take

LEVELS = (0, 3)
COUNTS = (2, 4, 8, 16, 32)
SECONDS, FPS = 60.0, 30.0


def bake_tables(take: Take) -> list[Table]:
    """Bake `take` in Blender, where the extension need not be registered."""
    rows = [row for level in LEVELS for row in _bakes(take, level)]
    title = f"Baking {len(take)} frames"
    return [
        Table(title, ("vertices", "target", "keys", "worst error, % of the eye distance", "s"), rows),
        Table("Writing the curves of a minute at 30 frames per second, 52 keys", ("what", "s"), [_curves()]),
    ]


def _bakes(take: Take, level: int) -> list[tuple[str, str, int, float, float]]:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        bakes = [BakeSettings(max_keys=count) for count in COUNTS]
        bakes += [BakeSettings(), BakeSettings(clean=0.005), BakeSettings(keys="cache", path=Path(folder) / "bake.pc2")]
        names = [f"at most {count} new keys" for count in COUNTS]
        names += ["new keys within 0.9 %", "the same, curves cleaned within 0.5 %", "Mesh Cache"]
        if level == 0:
            bakes += [BakeSettings(keys="named"), BakeSettings(keys="mapped")]
            names += ["ARKit keys, fitted", "ARKit keys, by mapping"]
        for name, bake in zip(names, bakes, strict=True):
            head = _head(level, bake)
            seconds, report = _timed(
                lambda head=head, bake=bake: puppet_head(bpy.context.scene, head, take, PuppetSettings(bake=bake))
            )
            rows.append((f"{len(head.data.vertices):,}", name, report.keys, 100.0 * report.worst_error, seconds))
    return rows


def _head(level: int, bake: BakeSettings) -> bpy.types.Object:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return dense_head(level) if level else add_head(bpy.context, units=bake.uses_existing_keys)


def _curves() -> tuple[str, float]:
    """Seconds for writing only the curves."""
    head = _head(0, BakeSettings(keys="named"))
    frames = 1.0 + np.arange(SECONDS * FPS)
    curves = [
        Curve(f'key_blocks["{name}"].value', 0, np.sin(0.1 * i + 0.05 * frames) ** 2)
        for i, name in enumerate(COEFFICIENTS)
    ]
    seconds, _ = _timed(lambda: write_curves(head.data.shape_keys, "Bench", frames, curves))
    return f"{len(frames)} frames", seconds


def _timed(work: Callable) -> tuple[float, object]:
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result
