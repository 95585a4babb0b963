"""Work with long parts that do not touch Blender, which operators do in a thread and commands at once."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, TypeVar, cast

from ..core.errors import FacemimeError

Result = TypeVar("Result")


@dataclass
class Task:
    """A long part of a work, which does not touch Blender.

    `run` does it in any thread, and what it returns is sent to the work; `done` is the share of the whole work that is
    done, 0 to 1, which `run` may update.
    """

    run: Callable[[], Any]
    done: float = 0.0


Work = Generator[Task, Any, Result]
"""Work on the main thread that yields its long parts, and is sent what they return, or the error that they raise."""


def do_at_once(work: Work[Result]) -> Result:
    """Do all parts of a work on this thread, and return its result."""
    resume: Callable[[Any], Task] = work.send
    outcome: Any = None
    try:
        while True:
            task = resume(outcome)
            try:
                resume, outcome = work.send, task.run()
            except FacemimeError as error:
                resume, outcome = work.throw, error
    except StopIteration as end:
        return cast(Result, end.value)
