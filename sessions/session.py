"""Base of sessions, whose threads never touch bpy.

One session runs at a time. Whatever ends it (a button, Esc, another file, undo, disabling the extension, quitting
Blender) goes through `Session.close`.
"""

from __future__ import annotations

import atexit
from typing import Self

import bpy

from ..blender.animation.bake import pose_targets_of
from ..blender.animation.conflicts import overruled, unseen
from ..blender.animation.live import LiveHeadObject
from ..blender.animation.live_mesh import clear_all_live
from ..blender.controls.checks import slowness
from ..blender.messages import show_error
from ..blender.registering import watch
from ..core.errors import HeadError, Message

_INTERVAL = 0.02


class Session:
    """Base class of sessions, which start when they are created.

    Attributes
    ----------
    closed : bool
        Whether the session has ended.
    warning : str
        What is to be reported at the end; "" for nothing.
    heads : list of LiveHeadObject
        The heads that it moves.
    """

    current: Session | None = None
    """The running session, or one that is closed but still `pending`."""

    def __init__(self) -> None:
        if (previous := Session.current) is not None:
            previous.close()
            previous.attend()
        self.closed = self._closing = False
        self.warning = ""
        self.heads: list[LiveHeadObject] = []
        self._objects_seen = len(bpy.data.objects)
        Session.current = self

    @classmethod
    def running(cls) -> Self | None:
        """Return the running session if it is of this class, otherwise None."""
        session = Session.current
        return session if isinstance(session, cls) and not session.closed else None

    def close(self, *, blocks: bool = True) -> None:
        """End the session; may be called twice.

        `blocks` is whether data-blocks may be removed, for which an undo step is pushed.
        """
        if self.closed:
            return
        self.closed = True
        self._stop()
        self._restore(blocks=blocks)
        self._forget()
        self.attend_later()

    def close_later(self) -> None:
        """Close the session at the next opportunity, where Blender would crash if an undo step were pushed now."""
        self._closing = True
        self.attend_later()

    def abandon(self) -> None:
        """End only the threads, when Blender's data has already been freed."""
        self.closed = True
        self._stop()
        Session.current = None

    def before_undo(self) -> None:
        """Restore the heads before an undo or redo."""
        self.suspend()

    def survives_undo(self) -> bool:
        """Find the heads again after an undo, and return whether the step that was loaded was taken in the session."""
        try:
            self.heads = [head.found_again() or head for head in self.heads]
            return any(head.left_in_file for head in self.heads)
        except HeadError as error:  # one of them can no longer be driven
            self.warning = str(error)
            return False

    def overruled(self) -> list[str]:
        """Return warnings about what keeps the pose of the heads from being seen, or from being shown in time."""
        if not self.heads:
            return []
        targets = [target for shown in self.heads for target in pose_targets_of(shown.obj, shown.targets)]
        follow = self.heads[0].follow
        rigs = [rig for shown in self.heads for rig in shown.rigs]
        hidden = unseen(shown.obj for shown in self.heads)
        slow = [slowness(shown.obj) for shown in self.heads if shown.controls is not None]
        return [
            *hidden,
            *filter(None, slow),
            *overruled(targets, rotation=follow.rotation, translation=follow.translation, rigs=rigs),
        ]

    def rest_copies(self) -> None:
        """Put objects at rest that were duplicated from those that the session moves, if there are other objects than
        at the last call.
        """
        if (count := len(bpy.data.objects)) != self._objects_seen:
            self._objects_seen = count
            clear_all_live(blocks=False, but=self.blocks)

    def warn_of_applied(self) -> None:
        """Say that the pose of a head was made part of its rest shape, as undoing that is up to the user."""
        applied = dict.fromkeys(name for shown in self.heads for name in shown.newly_applied())
        if applied:
            show_error(
                Message(
                    "The pose of {names} was applied to the rest shape. Undo that, and stop the puppet or the preview "
                    "before you apply it again.",
                    names=", ".join(applied),
                )
            )

    @property
    def blocks(self) -> set[bpy.types.ID]:
        """The data-blocks that the session changes."""
        return set().union(*(head.blocks for head in self.heads))

    @property
    def pending(self) -> bool:
        """Whether `attend` has work to do, possibly after the session has ended."""
        return self._closing and not self.closed

    def attend(self) -> None:
        """Do pending work other than displaying frames; called by a timer as long as the session is `pending`."""
        if self._closing:
            self.close()
        self._forget()

    @property
    def has_events(self) -> bool:
        """Whether a modal operator handles the session; its context has a window, unlike that of a timer."""
        return False

    def attend_later(self) -> None:
        """Start the timer that calls `attend`, if the session is `pending`."""
        if self.pending:
            watch(_attend, _INTERVAL)

    def suspend(self) -> None:
        """Restore the heads while the file is saved."""
        for shown in self.heads:
            shown.detach(keep=False, blocks=False)

    def resume(self) -> None:
        """Display the motion again after `suspend`."""

    def _stop(self) -> None:
        """End the threads, without touching Blender's data."""

    def _restore(self, *, blocks: bool) -> None:
        """Restore what the session has moved; `blocks` as for `close`."""

    def _forget(self) -> None:
        if Session.current is self and self.closed and not self.pending:
            Session.current = None


def _attend() -> float | None:
    if Session.current is not None and not Session.current.has_events:
        Session.current.attend()
    return None if Session.current is None or not Session.current.pending else _INTERVAL


def _close_without_removal(*_: object) -> None:
    """Close the session before another file is loaded, when no data-block may be removed."""
    if Session.current is not None:
        Session.current.close(blocks=False)


def _clear_undone(*_: object) -> None:
    """Remove what a session displayed from an undo step that was pushed during it; if it is running, it goes on."""
    session = Session.running()
    goes_on = session is not None and session.survives_undo()
    clear_all_live(blocks=False)
    if session is None:
        return
    if goes_on:
        _resume()
    else:
        session.warning = session.warning or Message("The start of the puppet was undone, which stopped it")
        session.close(blocks=False)


def _clear_opened(*_: object) -> None:
    """Remove what a session displayed from a file that was saved during it, or by Blender before a crash.

    What was pending belonged to the previous file. Its recordings are in its folder, where Find Takes finds them.
    """
    Session.current = None
    clear_all_live(blocks=True)


def _suspend(*_: object) -> None:
    if (session := Session.running()) is not None:
        session.suspend()


def _before_undo(*_: object) -> None:
    if (session := Session.running()) is not None:
        session.before_undo()


def _resume(*_: object) -> None:
    if (session := Session.running()) is not None:
        try:
            session.resume()
        except HeadError as error:  # the head was changed and can no longer be driven
            session.warning = str(error)
            session.close(blocks=False)


def _abandon_current() -> None:
    if Session.current is not None:
        Session.current.abandon()


HANDLERS = {
    "load_pre": _close_without_removal,
    "load_post": _clear_opened,
    "undo_pre": _before_undo,
    "redo_pre": _before_undo,
    "undo_post": _clear_undone,
    "redo_post": _clear_undone,
    "save_pre": _suspend,
    "save_post": _resume,
    "save_post_fail": _resume,
}
TIMERS = (_attend,)


def register() -> None:
    """Abandon a running session when Blender quits."""
    atexit.register(_abandon_current)


def unregister() -> None:
    """Close a running session."""
    if Session.current is not None:
        Session.current.close()
    Session.current = None
    atexit.unregister(_abandon_current)
