"""The list of takes: record, show, import, export, pack, remove, and what recordings a crash left."""

import contextlib

import bpy
from bpy.props import StringProperty

from ..blender.registering import watch
from ..blender.undo import push_undo
from ..core.errors import OutputError, SourceError
from ..core.takes.file import SUFFIX, load_take, save_take
from ..core.takes.spreadsheet import from_csv, to_csv
from ..sessions.recording import Recording, settle, start_recording, stop_recording
from ..sessions.session import Session
from ..sessions.show import TakeShow
from ..settings import takes_store
from .puppet import running
from .shared import AsksForFile, AsksForFileToWrite, ReportsErrors, heads_in, with_heads

_WATCH = 0.25


class OnTake(ReportsErrors):
    """Mixin: needs a take chosen in the list."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a take chosen."""
        takes = context.scene.facemime_takes
        if not 0 <= takes.index < len(takes.items):
            cls.poll_message_set("Record or import a take first")
            return False
        return True


class FACEMIME_OT_record_take(ReportsErrors, bpy.types.Operator):
    """Record all that is tracked while the puppet runs; the file is on the disk from the first second on"""

    bl_idname = "facemime.record_take"
    bl_label = "Record Take"
    bl_options = {"REGISTER"}

    name: StringProperty(name="Name", default="Take")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while the puppet runs, or something is being recorded."""
        if running() is None and Recording.current is None:
            cls.poll_message_set("Start the puppet first: step Puppet, above")
            return False
        return True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Begin, or end and list what was recorded."""
        if Recording.current is None:
            start_recording(running(), context.scene, self.name)
            watch(_watch, _WATCH)
            return {"FINISHED"}
        recording = Recording.current
        try:
            stop_recording()
        finally:
            listed = settle()
        if recording.video_failed:
            self.report({"WARNING"}, f"No video could be written beside {recording.path.name}. Is the disk full?")
        if listed:
            bpy.ops.ed.undo_push(message="Record Take")
        return {"FINISHED"}


class FACEMIME_OT_show_take(OnTake, bpy.types.Operator):
    """Show the chosen take on the active and the selected heads at the scene's frame, without baking; again to stop"""

    bl_idname = "facemime.show_take"
    bl_label = "Show Take"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while something else moves the heads."""
        if isinstance(Session.current, TakeShow):
            return True
        if Session.current is not None:
            cls.poll_message_set("It is running already. Stop it first")
            return False
        return with_heads(cls, context) and super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        if isinstance(Session.current, TakeShow):
            Session.current.close()
        else:
            TakeShow(context.scene, heads_in(context), takes_store.read(takes_store.chosen(context.scene)))
        return {"FINISHED"}


class FACEMIME_OT_remove_take(OnTake, bpy.types.Operator):
    """Take the chosen take off the list; its file stays where it is"""

    bl_idname = "facemime.remove_take"
    bl_label = "Remove Take"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        takes = context.scene.facemime_takes
        takes.items.remove(takes.index)
        takes.index = max(0, min(takes.index, len(takes.items) - 1))
        return {"FINISHED"}


class FACEMIME_OT_find_takes(ReportsErrors, bpy.types.Operator):
    """List takes that lie in the folder and are not listed: removed ones, or recorded before a crash"""

    bl_idname = "facemime.find_takes"
    bl_label = "Find Takes"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        """List them."""
        found, unreadable = 0, []
        for path in takes_store.unlisted(context.scene):
            try:
                takes_store.add(context.scene, path)
                found += 1
            except takes_store.MisnamedError as error:
                self.report({"WARNING"}, str(error))
            except SourceError:
                unreadable.append(path.name)
        self.report({"INFO"}, f"{found} takes found in {takes_store.folder()}")
        if unreadable:
            self.report(
                {"WARNING"}, f"Nothing can be read in {', '.join(unreadable)}. Delete these files, or ignore them."
            )
        return {"FINISHED"}


class FACEMIME_OT_import_take(AsksForFile, bpy.types.Operator):
    """List a take from a file, or a table of numbers as a take"""

    bl_idname = "facemime.import_take"
    bl_label = "Import Take"
    bl_options = {"REGISTER", "UNDO"}

    filter_glob: StringProperty(default="*.facetake;*.csv", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Read it and list it."""
        path = self.path
        if path.suffix.lower() == ".csv":
            takes_store.keep(context.scene, from_csv(path), path.stem)
            return {"FINISHED"}
        take = load_take(path)
        takes_store.add(context.scene, path, take)
        if told := take.info.get("recovered"):
            self.report({"WARNING"}, told)
        return {"FINISHED"}


class FACEMIME_OT_export_take(AsksForFileToWrite, OnTake, bpy.types.Operator):
    """Write the chosen take to a file of its own, or as a table of numbers"""

    bl_idname = "facemime.export_take"
    bl_label = "Export Take"
    bl_options = {"REGISTER"}

    filter_glob: StringProperty(default="*.facetake;*.csv", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        take = takes_store.read(takes_store.chosen(context.scene))
        if self.path.suffix.lower() == ".csv":
            to_csv(take, self.path)
        else:
            save_take(take, self.path_ending(SUFFIX))
        return {"FINISHED"}


class FACEMIME_OT_pack_take(OnTake, bpy.types.Operator):
    """Keep the chosen take within the .blend, or write it to a file again"""

    bl_idname = "facemime.pack_take"
    bl_label = "Pack Take"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        line = takes_store.chosen(context.scene)
        if line.packed is None:
            takes_store.pack(line)
        else:
            self.report({"INFO"}, f"Written to {takes_store.unpack(line)}")
        return {"FINISHED"}


def _watch() -> float | None:
    """List a recording that ended with its session; every now and then until it has."""
    recording = Recording.current
    if recording is None:
        return None
    if recording.running:
        return _WATCH
    if settle():
        push_undo("Record Take")
    return None


CLASSES = (
    FACEMIME_OT_record_take,
    FACEMIME_OT_show_take,
    FACEMIME_OT_remove_take,
    FACEMIME_OT_find_takes,
    FACEMIME_OT_import_take,
    FACEMIME_OT_export_take,
    FACEMIME_OT_pack_take,
)
TIMERS = (_watch,)


def unregister() -> None:
    """Unregister the operators; a recording ends."""
    with contextlib.suppress(OutputError):  # nobody is there to read it, and what was written before is safe
        stop_recording()
    Recording.current = None
