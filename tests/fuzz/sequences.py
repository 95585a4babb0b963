"""Random sequences of steps in Blender: all operators of Facemime, mixed with changes that users make to a scene.

Run as a program in any Blender's Python: sequences.py FIRST COUNT STEPS FOLDER [--bare] [--only N,N,...]

It prints "seed N" before each sequence and "step N NAME" before each step, so that whoever reads knows what ended it,
and "fault NAME" with a traceback for each step that raised what no user should see. With --bare Facemime's own steps
are left out, and Suzanne stands in for its head: what still ends Blender then is Blender's own. With --only a sequence
is cut down to the given steps.
"""

from __future__ import annotations

import io
import os
import sys
import threading
import traceback
import webbrowser
from contextlib import redirect_stderr
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import bpy
import numpy as np

import facemime
from facemime.core.puppet.sources import PacedSource
from facemime.operators.attached_parts import attend as attend_parts
from facemime.sessions.session import Session
from tests.fuzz.stage import Files, Stage
from tests.fuzz.steps import NAMES, OURS, STAND_INS, STEPS
from tests.helpers.clocks import AskedClock
from tests.helpers.live_ticks import attend

PACKAGE = str(Path(facemime.__file__).parent)


def expected(error: RuntimeError) -> bool:
    """Whether an operator failed with a message, as it should, rather than with a traceback."""
    return "Traceback" not in str(error) or PACKAGE not in str(error)


def play(seed: int, count: int, files: Files, bare: bool, only: set[int] | None) -> None:
    """Play a sequence; a seed gives the same steps with and without Facemime."""
    names = [NAMES[i] for i in np.random.default_rng(seed).integers(len(NAMES), size=count)]
    print(f"seed {seed}", flush=True)
    files.blend.unlink(missing_ok=True)
    bpy.ops.wm.read_homefile(use_empty=bool(seed % 2), use_factory_startup=True)
    for number, chosen in enumerate(["add_head", "puppet", "tick", *names]):
        name = STAND_INS.get(chosen, chosen if chosen not in OURS else "") if bare else chosen
        if not name or (only is not None and number not in only):
            continue
        stage = Stage(files, np.random.default_rng([seed, number]))
        print(f"step {number} {name}", flush=True)
        printed = io.StringIO()
        try:
            with redirect_stderr(printed):
                STEPS[name](stage)
                if not bare:
                    let_parts_follow()
        except RuntimeError as error:
            if not expected(error):
                print(f"fault {name}\n{error}", flush=True)
        except (ReferenceError, KeyError, TypeError, AttributeError, ValueError, AssertionError, IndexError):
            print(f"fault {name}\n{traceback.format_exc()}", flush=True)
        if "Traceback" in printed.getvalue() and PACKAGE in printed.getvalue():
            print(f"fault {name}\n{printed.getvalue()}", flush=True)
    if Session.current is not None:
        Session.current.close()
    attend()
    if Session.current is not None:
        print("fault a session goes on", flush=True)
    if left := [thread.name for thread in threading.enumerate() if thread.name.startswith("facemime")]:
        print(f"fault threads are left: {left}", flush=True)


def let_parts_follow() -> None:
    """Update the scene, and let the timer do what is due."""
    bpy.context.view_layer.update()
    attend_parts()


def main(arguments: list[str]) -> None:
    """Play sequences FIRST to FIRST + COUNT."""
    only = None
    if "--only" in arguments:
        only = {int(number) for number in arguments[arguments.index("--only") + 1].split(",")}
    first, count, steps = (int(argument) for argument in arguments[:3])
    files = Files(Path(arguments[3]))
    facemime.register()
    webbrowser.open = lambda *_, **__: True  # nobody is there to look at a browser
    try:
        PacedSource.pace = AskedClock()
        for seed in range(first, first + count):
            play(seed, steps, files, "--bare" in arguments, only)
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    finally:
        facemime.unregister()
    print("done", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
    # Blender as a module frees its own panels after Python has ended, and may crash then; Blender's program does not.
    os._exit(0)
