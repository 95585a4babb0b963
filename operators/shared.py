"""What operators share: how errors reach the user, what must be there, how a file is asked for."""

from collections.abc import Callable

import bpy

from ..blender.meshes import is_head
from ..core.errors import FacemimeError


class ReportsErrors:
    """Mixin: turns the errors that users can cause into a report and CANCELLED; the rest go up with a traceback."""

    def reporting(self, work: Callable[[bpy.types.Context], set[str]], context: bpy.types.Context) -> set[str]:
        """Return what `work` returns, or CANCELLED after a report."""
        try:
            return work(context)
        except FacemimeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}


def in_object_mode(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """For `poll`: whether Blender is in Object mode; `operator` tells the user to switch where it is not."""
    if context.mode == "OBJECT":
        return True
    operator.poll_message_set("Switch to Object mode first")
    return False


class AsksForFile:
    """Mixin: asks for `filepath` before it runs."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class OnMesh(ReportsErrors):
    """Mixin: needs a mesh active, and does its `work` on it."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a mesh active."""
        if context.active_object is None or context.active_object.type != "MESH":
            cls.poll_message_set("Select a head mesh")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work on the active mesh."""
        return self.reporting(self.work, context)


class OnHead(OnMesh):
    """Mixin: needs a head active, not in Edit mode, where vertex groups cannot be written."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a head active, outside Edit mode."""
        if not super().poll(context):
            return False
        if not is_head(context.active_object):
            cls.poll_message_set("Bind the landmarks first: step Head, above")
            return False
        if context.mode == "EDIT_MESH":
            cls.poll_message_set("Leave Edit mode first")
            return False
        return True


def watch(step: Callable[[], float | None], seconds: float) -> None:
    """Let Blender call `step` after `seconds` and as it then asks, whatever file is open; asked twice, it is one."""
    if not bpy.app.timers.is_registered(step):
        bpy.app.timers.register(step, first_interval=seconds, persistent=True)


def unwatch(step: Callable[[], float | None]) -> None:
    """Call it no longer: Blender 4.2 ends in a crash where a timer still waits, or was dropped with its file."""
    if bpy.app.timers.is_registered(step):
        bpy.app.timers.unregister(step)


def push_undo(message: str) -> None:
    """An undo step from a timer, which has no window of its own; nothing where there is no window at all."""
    if windows := bpy.context.window_manager.windows:
        with bpy.context.temp_override(window=windows[0]):
            bpy.ops.ed.undo_push(message=message)


def register_all(classes: tuple[type, ...]) -> None:
    """Register `classes` in their order."""
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister_all(classes: tuple[type, ...]) -> None:
    """Unregister `classes`, the last first."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
