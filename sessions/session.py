"""What has a lifetime: threads that never touch bpy, and what they move.

One session runs at a time. Whatever ends it (a button, ESC, another file, an undo, the extension disabled, Blender
quitting) ends in `Session.close`.
"""

from __future__ import annotations

import atexit

from bpy.app.handlers import persistent

from ..blender.animation.live import clear_all_live
from ..blender.registering import watch
from ..blender.undo import push_undo
from ..core.errors import HeadError


class Session:
    """Base: the one session that runs."""

    current: Session | None = None

    def __init__(self) -> None:
        if Session.current is not None:
            Session.current.close()
        Session.current = self

    def close(self, *, blocks: bool = True) -> None:
        """End it; may be called twice.

        Parameters
        ----------
        blocks : bool
            Whether data-blocks may be removed, and an undo step made for that.
        """
        if Session.current is self:
            Session.current = None

    def abandon(self) -> None:
        """End its threads alone, where Blender's data is gone already."""
        self.close()

    def suspend(self) -> None:
        """Put what it moves back for a moment: to save the file without what is only shown."""

    def resume(self) -> None:
        """Show it again after `suspend`."""


@persistent
def _close_as_it_is(*_: object) -> None:
    """Before a step is undone, or another file opened."""
    if Session.current is not None:
        Session.current.close(blocks=False)


@persistent
def _clear_undone(*_: object) -> None:
    """A step that was made while a session ran has in it what was shown then."""
    clear_all_live(blocks=False)


def clear_later() -> None:
    """Take out what a session left that could remove no data-block where it ended, when Blender has time for it."""
    watch(_clear_left, 0.05)


def _clear_left() -> None:
    if Session.current is None and clear_all_live(blocks=True):
        push_undo("Stop Puppet")


@persistent
def _clear_opened(*_: object) -> None:
    """A file that was saved while a session ran, or by Blender itself before a crash, too."""
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
        except HeadError:  # changed so that nothing can be shown on it any longer
            Session.current.close()


def _abandon_current() -> None:
    if Session.current is not None:
        Session.current.abandon()


HANDLERS = {
    "load_pre": _close_as_it_is,
    "load_post": _clear_opened,
    "undo_pre": _close_as_it_is,
    "redo_pre": _close_as_it_is,
    "undo_post": _clear_undone,
    "redo_post": _clear_undone,
    "save_pre": _suspend,
    "save_post": _resume,
    "save_post_fail": _resume,
}
TIMERS = (_clear_left,)


def register() -> None:
    """End a running session before another file is loaded or a step undone, and at Blender's end."""
    atexit.register(_abandon_current)


def unregister() -> None:
    """End a running session with the extension."""
    if Session.current is not None:
        Session.current.close()
    atexit.unregister(_abandon_current)
