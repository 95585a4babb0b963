"""Base of sessions, whose threads never touch bpy.

One session runs at a time. Whatever ends it (a button, Esc, another file, undo, disabling the extension, quitting
Blender) goes through `Session.close`.
"""

from __future__ import annotations

import atexit

from bpy.app.handlers import persistent

from ..blender.animation.live import clear_all_live
from ..blender.registering import watch
from ..blender.undo import push_undo
from ..core.errors import HeadError


class Session:
    """Base class of sessions; `current` is the running one."""

    current: Session | None = None

    def __init__(self) -> None:
        if Session.current is not None:
            Session.current.close()
        Session.current = self

    def close(self, *, blocks: bool = True) -> None:
        """End the session; may be called twice.

        Parameters
        ----------
        blocks : bool
            Whether data-blocks may be removed, for which an undo step is pushed.
        """
        if Session.current is self:
            Session.current = None

    def abandon(self) -> None:
        """End only the threads, when Blender's data has already been freed."""
        self.close()

    def suspend(self) -> None:
        """Restore what the session moves while the file is saved."""

    def resume(self) -> None:
        """Display the motion again after `suspend`."""


@persistent
def _close_without_removal(*_: object) -> None:
    """Close the session before an undo or before another file is loaded, when no data-block may be removed."""
    if Session.current is not None:
        Session.current.close(blocks=False)


@persistent
def _clear_undone(*_: object) -> None:
    """Remove what a session displayed from an undo step that was pushed during it."""
    clear_all_live(blocks=False)


def clear_later() -> None:
    """Remove the data-blocks that a session left when it ended, at the next opportunity."""
    watch(_clear_left, 0.05)


def _clear_left() -> None:
    if Session.current is None and clear_all_live(blocks=True):
        push_undo("Stop Puppet")


@persistent
def _clear_opened(*_: object) -> None:
    """Remove what a session displayed from a file that was saved during it, or by Blender before a crash."""
    clear_all_live(blocks=True)


@persistent
def _suspend(*_: object) -> None:
    if Session.current is not None:
        Session.current.suspend()


@persistent
def _resume(*_: object) -> None:
    if Session.current is not None:
        try:
            Session.current.resume()
        except HeadError:  # the head was changed and can no longer be driven
            Session.current.close()


def _abandon_current() -> None:
    if Session.current is not None:
        Session.current.abandon()


HANDLERS = {
    "load_pre": _close_without_removal,
    "load_post": _clear_opened,
    "undo_pre": _close_without_removal,
    "redo_pre": _close_without_removal,
    "undo_post": _clear_undone,
    "redo_post": _clear_undone,
    "save_pre": _suspend,
    "save_post": _resume,
    "save_post_fail": _resume,
}
TIMERS = (_clear_left,)


def register() -> None:
    """Abandon a running session when Blender quits."""
    atexit.register(_abandon_current)


def unregister() -> None:
    """Close a running session."""
    if Session.current is not None:
        Session.current.close()
    atexit.unregister(_abandon_current)
