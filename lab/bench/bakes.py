"""Speed and accuracy of bakes to keys and to caches; part of `python -m lab.bench.takes`."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from facemime.blender.actions import Curve, write_curves
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.face.names import COEFFICIENTS
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.take import Take
from lab.bench.live import dense_head
from lab.bench.report import Table

COUNTS = (2, 4, 8, 16)
FINER = 3
"""How often the edges of the dense head are halved."""
SECONDS, FPS = 60.0, 30.0
_ERRORS = (0.1, 0.25, 0.5, 1.0)
"""Errors of curves, % of the eye distance."""
_CURVES = ("ARKit's keys: frames per keyframe", "and residual ones: frames per keyframe")


def bake_tables(take: Take) -> list[Table]:
    """Bake `take` in Blender, where the extension need not be registered."""
    with tempfile.TemporaryDirectory() as folder:
        own, dense = (_bakes(take, level, Path(folder)) for level in (0, FINER))
    rows = [
        (name, keys, error, seconds, *dense.get(name, ("", "", ""))[2:]) for name, (keys, error, seconds) in own.items()
    ]
    columns = ("baked to", "keys", "largest error, % of the eye distance", *(f"{n:,} vertices, s" for n in _sizes()))
    return [
        Table(f"Baking the {len(take)} frames of the sample clip", columns, rows),
        Table("Keyframes of the sample clip", ("error of curves, % of the eye distance", *_CURVES), _keyframes(take)),
        Table("Writing the curves of a minute at 30 frames per second, 52 keys", ("what", "s"), [_curves()]),
    ]


def _bakes(take: Take, level: int, folder: Path) -> dict[str, tuple[int, float, float]]:
    """Number of keys, largest error and seconds of each bake, by name."""
    bakes = {f"at most {count} new keys": BakeSettings(keys="new", max_keys=count) for count in COUNTS}
    bakes["new keys, within 0.9 %"] = BakeSettings(keys="new")
    bakes["the same, a keyframe in each frame"] = BakeSettings(keys="new", clean=0.0)
    if not level:
        bakes["ARKit's keys, fitted"] = BakeSettings(keys="named", residual=False)
        bakes["ARKit's keys and residual ones"] = BakeSettings(keys="named")
        bakes["ARKit's keys, mapped"] = BakeSettings(keys="mapped")
    bakes["Mesh Cache"] = BakeSettings(keys="cache", path=folder / "bake.pc2")
    found = {}
    for name, bake in bakes.items():
        head, settings = _head(level, bake), PuppetSettings(bake=bake)
        seconds, report = _timed(
            lambda head=head, settings=settings: puppet_head(bpy.context.scene, head, take, settings)
        )
        found[name] = report.keys, 100.0 * report.worst_error, seconds
    return found


def _keyframes(take: Take) -> list[tuple[float | str, ...]]:
    """Frames per keyframe for each error, of ARKit's keys and of these and residual ones."""
    rows: list[tuple[float | str, ...]] = []
    for percent in _ERRORS:
        row: list[float | str] = [percent]
        for residual in (False, True):
            bake = BakeSettings(keys="named", residual=residual, clean=0.01 * percent)
            head = _head(0, bake)
            report = puppet_head(bpy.context.scene, head, take, PuppetSettings(bake=bake))
            row.append(report.frames / report.keyframes)
        rows.append(tuple(row))
    return rows


def _sizes() -> tuple[int, int]:
    """Numbers of vertices of both heads."""
    own, dense = (len(_head(level, BakeSettings()).data.vertices) for level in (0, FINER))
    return own, dense


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
