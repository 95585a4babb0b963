"""Operators that delete, duplicate and link the parts of a head with it, and the handlers that call them.

Blender's operators handle objects separately, so the parts follow at the next update of the scene. An operator that
does this belongs to the undo group of the user's step, which it extends: a single undo reverts both.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ..blender.contexts import in_a_window, push_undo
from ..blender.heads import attached
from ..blender.registering import watch
from ..blender.stubs import OperatorResult
from ..sessions.session import Session

_STEPS = ("Delete", "Duplicate Objects", "Duplicate Linked", "Append", "Link", "Paste Objects", "Add Parts")
"""Names of undo steps that are extended; the last is that of a separate step, after any other."""
_INTERVAL = 0.01


class _Watch:
    """State at the last update.

    Attributes
    ----------
    known : set of int
        `session_uid` of the heads.
    hidden : dict of int to bool
        Whether each head was hidden.
    undone : tuple of int
        State that an undo has left unfinished, which is not changed, as a new step would make redoing impossible.
    """

    known: set[int] = set()
    hidden: dict[int, bool] = {}
    undone: tuple[int, ...] = ()


class _FinishesParts:
    """Mixin: finishes what deleting, linking or duplicating heads has left undone."""

    bl_label = "Add Parts"

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Finish it."""
        _finish_parts()
        return {"FINISHED"}


def _finish_parts() -> None:
    """Finish what deleting, linking or duplicating heads has left undone, without an undo step."""
    attached.finish(attached.unfinished(), _Watch.known)
    _Watch.known = _present()


def _present() -> set[int]:
    return {head.session_uid for head in attached.heads_with_parts()}


def attend() -> float | None:
    """Finish what is left undone, once no operator is running that may be about to push its own step."""
    if (left := attached.unfinished()) and left.summary != _Watch.undone:
        windows = bpy.context.window_manager.windows
        if Session.running() is not None or any(map(_is_editing, windows)):
            return _INTERVAL
        with in_a_window():
            if bpy.ops.ed.undo.poll():  # type: ignore[call-arg]  # the stubs have a class instead of its instance
                _operator()("EXEC_DEFAULT", True)
            else:  # there is no step before the user's, which Blender needs to replace it
                _finish_parts()
                push_undo("Add Parts")
    else:
        _Watch.known = _present()
    return None


def _operator() -> Callable[[str, bool], object]:
    """Return the operator of the undo group to which the user's last operator belongs."""
    last = bpy.context.window_manager.operators
    name = last[-1].name if len(last) else ""
    number = _STEPS.index(name) if name in _STEPS else len(_STEPS) - 1
    own = bpy.ops.facemime  # type: ignore[attr-defined]  # registered at run time
    operator: Callable[[str, bool], object] = getattr(own, f"finish_parts_{number}")
    return operator


def _is_editing(window: bpy.types.Window) -> bool:
    """Return whether objects are being moved, as after Duplicate, which has not pushed its undo step yet."""
    names = [operator.bl_idname for operator in window.modal_operators if operator is not None]
    return any(name.startswith(("TRANSFORM_OT", "OBJECT_OT")) for name in names)


def _updated(scene: bpy.types.Scene, graph: bpy.types.Depsgraph) -> None:
    if not (graph.id_type_updated("SCENE") or graph.id_type_updated("COLLECTION")):
        return
    _Watch.hidden = attached.hide_with_heads(graph.view_layer, _Watch.hidden)
    if attached.unfinished() or _present() != _Watch.known:
        watch(attend, _INTERVAL)


def _undone(*_: object) -> None:
    _Watch.undone, _Watch.known = attached.unfinished().summary, _present()
    _Watch.hidden = attached.hidden_heads(bpy.context.view_layer)


def _opened(*_: object) -> None:
    attached.attach_all()
    attached.finish(attached.unfinished(), _present())
    _undone()


HANDLERS = {"depsgraph_update_post": _updated, "undo_post": _undone, "redo_post": _undone, "load_post": _opened}
TIMERS = (attend,)
CLASSES = tuple(
    type(
        f"FACEMIME_OT_finish_parts_{number}",
        (_FinishesParts, bpy.types.Operator),
        {
            "__doc__": "Let the parts of heads follow what was done to the heads",
            "bl_idname": f"facemime.finish_parts_{number}",
            "bl_options": {"INTERNAL", "UNDO_GROUPED"},
            "bl_undo_group": step,
        },
    )
    for number, step in enumerate(_STEPS)
)
