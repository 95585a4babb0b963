"""A live session from a test: the events that its operator gets, waiting for what they do, and what is seen then."""

import time
from types import SimpleNamespace

import bpy
import numpy as np

from facemime.operators.puppet import FACEMIME_OT_puppet, running

TIMER = SimpleNamespace(type="TIMER", value="NOTHING", ctrl=False, oskey=False)
CLICK = SimpleNamespace(type="LEFTMOUSE", value="PRESS", ctrl=False, oskey=False)


def tick(event=TIMER) -> set[str]:
    """One event for the operator that runs."""
    return FACEMIME_OT_puppet.instance.modal(bpy.context, event)


def ticks_until(condition, seconds: float = 30.0) -> None:
    """Ticks until `condition` holds or the operator has ended."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        if FACEMIME_OT_puppet.instance is None or tick() != {"PASS_THROUGH"}:
            assert condition()
            return
        time.sleep(0.002)


def outcome_of_ticks(seconds: float = 30.0) -> set[str]:
    """Ticks until the operator ends; how it ended."""
    end = time.monotonic() + seconds
    while (outcome := tick()) == {"PASS_THROUGH"}:
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.002)
    return outcome


def shown(obj: bpy.types.Object) -> np.ndarray:
    """(V, 3) what the viewport shows."""
    bpy.context.view_layer.update()
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def moving() -> bool:
    """Whether a frame with a face has been shown; the source must loop, as a busy machine drops frames."""
    session = running()
    return session is not None and session.shown is not None and session._number > 30 and bool(session.shown.heads)


def wait_for(condition) -> None:
    """Until the worker has come so far."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)
