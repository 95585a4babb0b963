"""Undo steps while other threads run Python, as they do during a puppet."""

import subprocess
import sys

from tests.helpers.blenders import ROOT

_PUSH = """
import os, threading
import bpy
from facemime.blender.contexts import push_undo

def allocate():
    while True:
        [str(number) for number in range(300)]

for _ in range(2):
    threading.Thread(target=allocate, daemon=True).start()
for number in range(100):
    push_undo(f"Step {number}")
os._exit(0)
"""


def test_undo_steps_are_pushed_while_other_threads_run_without_corrupting_memory():
    done = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", _PUSH], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_context_is_overridden_in_one_place_only():
    rooms = ("blender", "operators", "sessions", "settings", "ui")
    found = [path for room in rooms for path in (ROOT / room).rglob("*.py") if "temp_override(" in path.read_text()]
    assert {path.relative_to(ROOT).as_posix() for path in found} == {"blender/contexts.py", "operators/head.py"}
