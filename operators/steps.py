"""Long-running operators: Blender's window stays responsive, progress is shown, and Esc cancels."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator
from contextlib import closing
from typing import Any

import bpy

from ..blender.stubs import OperatorMixin, OperatorResult
from ..blender.work import Result, Work
from .shared import ReportsErrors

_TICK = 0.02
_WAIT = 0.02
"""Seconds between two redraws while a part is done in a thread."""
_SLICE = 0.05
"""Seconds of steps between two redraws."""
_NAVIGATION = {"MOUSEMOVE", "MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM"}


class ShowsProgress(OperatorMixin):
    """Mixin of modal operators: a timer ticks, and the pointer and the status bar show the progress."""

    _timer: bpy.types.Timer | None = None

    def start_ticking(self, context: bpy.types.Context, interval: float) -> OperatorResult:
        """Start the timer, with `interval` in seconds, and the progress, which goes from 0 to 1."""
        manager = context.window_manager
        self._timer = manager.event_timer_add(interval, window=context.window)
        manager.progress_begin(0.0, 1.0)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def stop_ticking(self, context: bpy.types.Context) -> None:
        """End the timer and the progress; may be called twice."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            context.window_manager.progress_end()
            context.workspace.status_text_set(None)
        self._timer = None


class WorksInSteps(ShowsProgress, ReportsErrors):
    """Mixin: runs the operator's `steps`, one by one if Blender has a window, and otherwise all at once.

    While it works in a window, nothing else can be changed there; the viewport can be turned. Esc closes the iterator
    of the steps, which must leave nothing incomplete.
    """

    in_window = False
    """Whether the work was started in a window."""
    _steps: Generator[float, None, None] | None = None

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Do the work; yield the fraction that is done, 0 to 1, whenever the window may be redrawn."""
        raise NotImplementedError

    def status(self) -> str:
        """Return the translated text that the status bar shows during the work."""
        raise NotImplementedError

    def work(self, context: bpy.types.Context) -> None:
        """Do all steps at once."""
        for _ in self.steps(context):
            pass

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Start the work."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        return self.reporting(self._start, context)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Do some steps."""
        if event.type == "ESC":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type == "TIMER":
            return self.reporting(self._go_on, context)
        return {"PASS_THROUGH"} if event.type in _NAVIGATION else {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop the work."""
        steps, self._steps = self._steps, None
        self.stop_ticking(context)
        if steps is not None:
            steps.close()

    def _start(self, context: bpy.types.Context) -> OperatorResult:
        self._steps, self.in_window = self.steps(context), True
        context.workspace.status_text_set(self.status())
        return self.start_ticking(context, _TICK)

    def _go_on(self, context: bpy.types.Context) -> OperatorResult:
        until, done, steps = time.perf_counter() + _SLICE, 0.0, self._steps
        assert steps is not None
        try:
            while time.perf_counter() < until:
                done = next(steps)
        except StopIteration:
            self.cancel(context)
            return {"FINISHED"}
        except BaseException:
            self.cancel(context)
            raise
        context.window_manager.progress_update(done)
        return {"RUNNING_MODAL"}


def in_background(work: Work[Result]) -> Generator[float, None, Result]:
    """Do the parts of a work in a thread, one after another; yield the share that is done, and return the result.

    When it is closed, the work is closed too, after the part that is running.
    """
    with closing(work):
        resume, outcome = work.send, None
        try:
            while True:
                task = resume(outcome)
                doing = Background(task.run)
                while not doing.wait(_WAIT):
                    yield task.done
                failed = doing.error is not None
                resume, outcome = (work.throw, doing.error) if failed else (work.send, doing.result)
        except StopIteration as end:
            result: Result = end.value
            return result


class Background:
    """Work in a thread, which must not touch Blender, with its `result`, or the `error` that it raised."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._work = work
        self.result: Any = None
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.name = "facemime-work"
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        """Wait at most `seconds`; return whether it has ended."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self.result = self._work()
        except Exception as error:  # raised again on the main thread
            self.error = error
