"""Live sessions in tests: frames on request, events of the operator, and what is displayed."""

import time
from types import SimpleNamespace

import bpy
import numpy as np

from facemime.core.puppet.sources import PacedSource
from facemime.operators.attached_parts import attend as attend_parts
from facemime.operators.puppet import running
from facemime.sessions.session import Session
from tests.helpers import clocks

TIMER = SimpleNamespace(type="TIMER", value="NOTHING", ctrl=False, oskey=False, mouse_x=0, mouse_y=0)
CLICK = SimpleNamespace(type="LEFTMOUSE", value="PRESS", ctrl=False, oskey=False, mouse_x=0, mouse_y=0)


def let_a_frame_come() -> None:
    """Process one more frame of a running session's source."""
    session, clock = running(), PacedSource.pace
    if session is not None and isinstance(session.worker.source, PacedSource) and isinstance(clock, clocks.AskedClock):
        clock.ask(lambda: session.worker.running)
    else:
        time.sleep(0.002)


def tick(event=TIMER) -> set[str]:
    """Send an event to the running operator."""
    return running().operator.modal(bpy.context, event)


def attend() -> None:
    """Let the timers do their work."""
    if Session.current is not None:
        Session.current.attend()
    attend_parts()


def ticks_until(condition) -> None:
    """Send frames and ticks until `condition` holds or the operator has ended."""
    end = time.monotonic() + clocks.PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        let_a_frame_come()
        if running() is None or tick() != {"PASS_THROUGH"}:
            assert condition()
            return


def outcome_of_ticks() -> set[str]:
    """Send frames and ticks until the operator ends; returns its result."""
    end = time.monotonic() + clocks.PATIENCE
    while True:
        assert time.monotonic() < end, "waited in vain"
        let_a_frame_come()
        if (outcome := tick()) != {"PASS_THROUGH"}:
            return outcome


def shown(obj: bpy.types.Object) -> np.ndarray:
    """(V, 3) vertices as displayed in the viewport."""
    bpy.context.view_layer.update()
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def moving() -> bool:
    """Whether a frame with a face past the thirtieth is shown, where `takes.performance` is far from its neutral."""
    session = running()
    return session is not None and session.shown is not None and session._number > 30 and bool(session.shown.heads)


def start() -> None:
    """Start the puppet, and wait until the selected heads move."""
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    ticks_until(moving)


def some_frames() -> None:
    """Continue for three frames."""
    number = running()._number
    ticks_until(lambda: running() is None or running()._number >= number + 3)


def wait_for(condition) -> None:
    """Send frames until the worker has reached a number."""
    clocks.wait_for(condition, let_a_frame_come)
