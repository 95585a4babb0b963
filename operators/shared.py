"""What operators share: how errors reach the user, what must be there, how a file is asked for."""

import os
from collections.abc import Callable
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..blender.meshes import is_head
from ..core.capture import check_readable, require_utf8_name
from ..core.errors import FacemimeError, SourceError


def message_of(error: Exception) -> str:
    """What `error` says, for a report: Blender takes none with the name of a file that is not UTF-8."""
    return str(error).encode(errors="backslashreplace").decode()


class ReportsErrors:
    """Mixin: does its `work`, which the operator brings; errors that users can cause become a report and CANCELLED.

    The rest go up with a traceback.
    """

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work."""
        return self.reporting(self.work, context)

    def reporting(self, work: Callable[[bpy.types.Context], set[str]], context: bpy.types.Context) -> set[str]:
        """Return what `work` returns, or CANCELLED after a report."""
        try:
            return work(context)
        except FacemimeError as error:
            self.report({"ERROR"}, message_of(error))
            return {"CANCELLED"}


def in_object_mode(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """For `poll`: whether Blender is in Object mode; `operator` tells the user to switch where it is not."""
    if context.mode == "OBJECT":
        return True
    operator.poll_message_set("Switch to Object mode first")
    return False


def heads_in(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The heads that a performance moves: the active one first, then the other selected ones."""
    chosen = [obj for obj in (context.active_object, *context.selected_objects) if obj is not None and is_head(obj)]
    return list(dict.fromkeys(chosen))


def with_heads(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """For `poll`: whether heads are chosen; `operator` tells the user to choose one where none is."""
    if heads_in(context):
        return True
    operator.poll_message_set("Select a head, or add one: step Head, above")
    return False


class AsksForFile(ReportsErrors):
    """Mixin: asks for a file before it runs; the operator's `filter_glob` says which ones are shown."""

    filepath: StringProperty(name="File", subtype="FILE_PATH", options={"SKIP_SAVE"})

    @property
    def path(self) -> Path:
        """The file that was chosen; SourceError where none was, or one that may not be read or has no valid name."""
        path = Path(bpy.path.abspath(self.filepath))
        if not path.name or os.path.isdir(path):  # the browser gives its folder where nothing was chosen
            raise SourceError("No file was chosen. Choose one, or type its name.")
        require_utf8_name(path)
        check_readable(path)
        return path

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class AsksForFileToWrite(AsksForFile):
    """Mixin: asks for a file that it writes; the browser warns of one that is there already."""

    check_existing: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def path_ending(self, suffix: str) -> Path:
        """The file that was named, with `suffix` behind its name where that ends otherwise."""
        path = self.path
        return path if path.suffix.lower() == suffix else path.with_name(path.name + suffix)


class OnMesh(ReportsErrors):
    """Mixin: needs a mesh active."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a mesh active."""
        if context.active_object is None or context.active_object.type != "MESH":
            cls.poll_message_set("Select a head mesh")
            return False
        return True


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
