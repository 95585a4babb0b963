"""Long puppetry in Blender's window with an interrupted source: memory, threads, tracebacks.

Usage: python tests/gui/soak.py [--minutes 10] [--suite sid]. Prints a line per interruption and JSON at the end; the
exit status is 0 only if memory does not grow beyond noise, no thread is left, and there is no traceback.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from pathlib import Path

import numpy as np

from tests.gui.conftest import SUITES, install
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.window import MODULE, ROOT, Blender, places

PERIOD = 20.0
GROWTH = 0.5
"""MiB per minute, the slope in the second half: more is a leak, less is noise."""
_START = f"""
import sys, threading
from {MODULE}.sessions.session import Session
def counts():
    session = Session.current
    if session is None:
        return None
    done = session.worker.counts
    return [done.tracked, done.lost, session.worker.message]
def workers():
    return sorted(thread.name for thread in threading.enumerate() if thread.name.startswith("facemime"))
source = bpy.context.scene.facemime.source
source.kind, source.video, source.loop = "VIDEO", {{clip!r}}, True
"""


def main() -> int:
    """Run it; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--suite", choices=SUITES, default="sid")
    arguments = parser.parse_args()
    with Blender(places()[arguments.suite], f"{arguments.suite}/soak") as blender:
        install(blender)
        measured = soak(blender, arguments.minutes)
        measured["tracebacks"] = blender.printed().count("Traceback")
    measured["ok"] = bool(
        measured["growth_mib_a_minute"] <= GROWTH
        and not measured["threads_left"]
        and not measured["tracebacks"]
        and measured["frames"] > 0
    )
    print(json.dumps(measured))
    return 0 if measured["ok"] else 1


def soak(blender: Blender, minutes: float) -> dict:
    """Run the puppet for some minutes; in every other period the clip is missing when it starts again."""
    clip = blender.folder / "clip.mp4"
    shutil.copy(ROOT / "assets" / "sample" / "sample.mp4", clip)
    sidebar = Sidebar(blender)
    sidebar.press("bpy.ops.facemime.add_head")
    blender.do(_START.format(clip=str(blender.inside / "clip.mp4")))
    sidebar.open_panel("FACEMIME_PT_puppet")
    sidebar.press("bpy.ops.facemime.puppet(")
    blender.wait_for("counts() is not None and counts()[0] > 5")
    began, memory, cuts, away = time.monotonic(), [], 0, clip.with_suffix(".away")
    while time.monotonic() - began < 60.0 * minutes:
        watch(blender, began, memory, PERIOD)
        clip.rename(away)
        blender.wait_for("counts()[2]")
        watch(blender, began, memory, PERIOD)
        away.rename(clip)
        blender.do("before = counts()[0]")
        blender.wait_for("counts()[0] > before + 5 and not counts()[2]")
        cuts += 1
        frames = blender.get("counts()[0]")
        print(f"{time.monotonic() - began:5.0f} s  {memory[-1][1]:7.1f} MiB  {frames} frames", flush=True)
    blender.shot("end")
    blender.move(blender.size[0] * 0.3, blender.size[1] * 0.6)
    blender.redraw()
    blender.key("Escape")
    blender.wait_for("counts() is None")
    minute, mib = np.array(memory).T
    late = minute >= minute[-1] / 2
    return {
        "blender": blender.get("bpy.app.version_string"),
        "minutes": round(float(minute[-1]), 1),
        "frames": frames,
        "cuts": cuts,
        "mib": [round(float(mib[0]), 1), round(float(mib[-1]), 1)],
        "growth_mib_a_minute": round(float(np.polyfit(minute[late], mib[late], 1)[0]), 3),
        "threads_left": blender.get("workers()"),
    }


def watch(blender: Blender, began: float, memory: list, seconds: float) -> None:
    """Record the memory every second."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(1.0)
        memory.append(((time.monotonic() - began) / 60.0, resident(blender.process.pid)))


def resident(pid: int) -> float:
    """Return the resident memory of a process, MiB."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    raise ProcessLookupError(pid)


if __name__ == "__main__":
    sys.exit(main())
