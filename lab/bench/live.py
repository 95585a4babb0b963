"""Live sessions: delay of each stage, and time of the main thread per tick.

The sample clip plays at its own speed and is tracked as in a live session. The heads are the built-in one and two that
are subdivided. Drawing is not included, as it is Blender's and needs a window. Run as `python -m lab.bench.live`.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from time import perf_counter

import bpy
import cv2
import numpy as np

import facemime
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks, write_landmarks
from facemime.core.puppet.timing import STAGES
from facemime.sessions.live import LiveSession
from facemime.sessions.start import follow_settings, start_session
from facemime.settings.preferences import preferences
from lab.bench.report import Table, bars, finish, parser

LEVELS = {0: "1,781", 2: "26k", 3: "100k"}
_PERIOD = 1.0 / 120.0
_PERCENTILES = (50.0, 95.0, 99.0)
_WARM = 30


@dataclass(frozen=True)
class Measured:
    """Results for a head: percentiles of the delays by stage, seconds of the ticks, and of the preparation."""

    vertices: int
    preview: bool
    delays: dict[str, tuple[float, ...]]
    ticks: tuple[float, ...]
    rate: float


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("--seconds", type=float, default=9.0, help="duration for each head (9)")
    arguments = command.parse_args()
    cv2.setNumThreads(1)
    facemime.register()
    try:
        measured = [measure(level, preview, arguments.seconds) for level in LEVELS for preview in (False, True)]
    finally:
        facemime.unregister()
    tables = [_table(one) for one in measured]
    ticks = [
        (f"{one.vertices:,}", "yes" if one.preview else "no", *(1e3 * t for t in one.ticks), one.rate)
        for one in measured
    ]
    columns = ("vertices", "preview", "median", "95th percentile", "99th percentile", "frames per second")
    tables.insert(0, Table("Time on the main thread per tick, ms", columns, ticks))
    if arguments.figure is not None:
        plain = [one for one in measured if not one.preview]
        names = [f"{one.vertices:,} vertices" for one in plain]
        bars(
            arguments.figure,
            "Time on the main thread per tick, 95th percentile",
            names,
            [1e3 * one.ticks[1] for one in plain],
            "ms",
        )
    finish(arguments, tables, {f"{one.vertices} {one.preview}": one.ticks for one in measured})
    return 0


def measure(level: int, preview: bool, seconds: float) -> Measured:
    """Drive a head with `level` subdivisions for `seconds`, with ticks as from Blender's timer."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    head = dense_head(level)
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.loop = "SAMPLE", True
    preferences().preview = preview
    session = start_session(bpy.context.scene, [head])
    try:
        return _ticked(session, bpy.context.scene, seconds, len(head.data.vertices), preview)
    finally:
        session.close()


def _ticked(session: LiveSession, scene: bpy.types.Scene, seconds: float, vertices: int, preview: bool) -> Measured:
    ticks: list[float] = []
    while len(ticks) < _WARM + seconds / _PERIOD / 3 and session.worker.error is None:
        began = perf_counter()
        follow_settings(session, scene)
        if session.step() and session.shown.heads:
            ticks.append(perf_counter() - began)
        bpy.context.view_layer.update()
        time.sleep(max(0.0, _PERIOD - (perf_counter() - began)))
    kept = np.percentile(ticks[_WARM:], _PERCENTILES)
    delays = session.stopwatch.percentiles(*_PERCENTILES)
    return Measured(vertices, preview, dict(delays), tuple(kept.tolist()), session.stopwatch.rate)


def dense_head(level: int) -> bpy.types.Object:
    """The built-in head with faces subdivided `level` times; original vertices come first."""
    head = add_head(bpy.context)
    if level:
        landmarks = read_landmarks(head)
        modifier = head.modifiers.new("Dense", "SUBSURF")
        modifier.levels, modifier.subdivision_type = level, "SIMPLE"
        bpy.ops.object.modifier_apply(modifier=modifier.name)
        write_landmarks(head.data, landmarks)
    return head


def _table(one: Measured) -> Table:
    title = f"Delay by stage at {one.vertices:,} vertices, {'with' if one.preview else 'without'} preview, ms"
    rows = [(stage, *(1e3 * t for t in one.delays[stage])) for stage in (*STAGES, "total")]
    return Table(title, ("stage", "median", "95th percentile", "99th percentile"), rows)


if __name__ == "__main__":
    sys.exit(main())
