"""Operators on the list of takes: record, show, remove, find, import, export, pack."""

from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.app.translations import pgettext_rpt as _
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ..blender.animation.sampling import Sampling
from ..core.errors import Message, SourceError
from ..core.puppet.sources import PacedSource
from ..core.takes.face_models import FPS, read_moving_face
from ..core.takes.face_parameters import SUFFIXES as PARAMETERS
from ..core.takes.file import SUFFIX, load_take, save_take
from ..core.takes.from_video import PICTURES_SKIPPED, VIDEO_CUT
from ..core.takes.numbered_meshes import SUFFIXES as MESHES
from ..core.takes.rates import MAX_FPS, MIN_FPS
from ..core.takes.recordings import SUFFIXES as RECORDINGS
from ..core.takes.recordings import read_recording
from ..core.takes.spreadsheet import to_csv
from ..core.takes.table_angles import AUTOMATIC, DEGREES, RADIANS
from ..core.takes.take import Take
from ..sessions.calibrating import COUNTDOWN
from ..sessions.live import LiveSession
from ..sessions.show import TakeShow
from ..settings import takes_store
from .puppet import FACEMIME_OT_puppet, required_puppet, running, start_puppet
from .shared import (
    AsksForFile,
    AsksForFileToWrite,
    Need,
    OnHead,
    ReportsErrors,
    heads_in,
    report,
    reporting_range,
    require,
    require_heads,
    require_mesh,
    require_no_session,
    required_subject,
)
from .steps import WorksInSteps


def require_take(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require a take selected in the list, as `require` does."""
    takes = context.scene.facemime_takes
    return require(operator, 0 <= takes.index < len(takes.items), "Record or import a take first")


class OnTake(ReportsErrors):
    """Mixin: requires a take selected in the list."""

    needs: ClassVar[tuple[Need, ...]] = (require_take,)


def _countdown(session: LiveSession, scene: bpy.types.Scene) -> float:
    """Return the seconds before a recording; by default performers in front of a camera get time to prepare."""
    chosen = scene.facemime_takes.countdown
    if chosen == "AUTO":
        return 0.0 if isinstance(session.worker.source, PacedSource) else COUNTDOWN
    return float(chosen)


class FACEMIME_OT_record_take(ReportsErrors, bpy.types.Operator):
    """Record everything that is tracked, starting the puppet if necessary; the take is saved while it is recorded"""

    bl_idname = "facemime.record_take"
    bl_label = "Record Take"
    bl_options = {"REGISTER"}

    name: StringProperty(name="Name", default="Take")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a running puppet, or that one can be started."""
        return running() is not None or FACEMIME_OT_puppet.poll(context)

    def work(self, context: bpy.types.Context) -> None:
        """Start recording, cancel the countdown, or stop and add the take to the list."""
        if running() is None:
            start_puppet()
        session = required_puppet()
        if session.recorder.recording is None:
            if not session.recorder.cancel_countdown():
                session.recorder.start_after(_countdown(session, context.scene), context.scene, self.name)
            return
        recording = session.recorder.recording
        session.recorder.stop()
        if dropped := recording.dropped:
            report(
                self,
                "{dropped} frames were skipped, as the video plays at its own rate. Track and Bake uses every frame",
                "WARNING",
                dropped=dropped,
            )
        if recording.video_failed:
            report(
                self,
                "The video of {name} could not be written. Check that the disk is not full.",
                "WARNING",
                name=recording.path.name,
            )


class FACEMIME_OT_show_take(OnTake, bpy.types.Operator):
    """Show the selected take on the active head and all other selected heads without baking; click again to stop"""

    bl_idname = "facemime.show_take"
    bl_label = "Preview on Head"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a head and a take, and that no other session than a puppet is running, which ends."""
        if TakeShow.running() is not None:
            return True
        free = running() is not None or require_no_session(cls, context)
        return free and require_heads(cls, context) and super().poll(context)

    def work(self, context: bpy.types.Context) -> None:
        if (puppet := running()) is not None:
            puppet.close()
        if (show := TakeShow.running()) is not None:
            show.close()
        else:
            with reporting_range(self, context.scene):
                line = takes_store.chosen(context.scene)
                take = takes_store.read_corrected(context.scene, line)
                show = TakeShow(context.scene, heads_in(context), take, line.path)
            for warning in show.warnings:
                report(self, warning, "WARNING")


class FACEMIME_OT_remove_take(OnTake, bpy.types.Operator):
    """Remove the selected take from the list; its file is kept"""

    bl_idname = "facemime.remove_take"
    bl_label = "Remove Take"

    def work(self, context: bpy.types.Context) -> None:
        takes = context.scene.facemime_takes
        takes.items.remove(takes.index)
        takes.index = max(0, min(takes.index, len(takes.items) - 1))


class FACEMIME_OT_find_takes(ReportsErrors, bpy.types.Operator):
    """Add takes in the folder that are not in the list, such as removed ones and those recorded before a crash"""

    bl_idname = "facemime.find_takes"
    bl_label = "Find Takes"

    def work(self, context: bpy.types.Context) -> None:
        """Add the takes to the list."""
        found, unreadable = 0, []
        for path in takes_store.unlisted(context.scene):
            try:
                takes_store.add(context.scene, path)
                found += 1
            except takes_store.MisnamedError as error:
                report(self, str(error), "WARNING")
            except SourceError:
                unreadable.append(path.name)
        folder = takes_store.folder()
        report(self, "{found} takes found in {folder}", found=found, folder=folder)
        if unreadable:
            report(
                self,
                "Files that cannot be read: {unreadable}. Delete or ignore them.",
                "WARNING",
                unreadable=", ".join(unreadable),
            )


class FACEMIME_OT_import_take(AsksForFile, bpy.types.Operator):
    """Add a take from a file to the list, or a table, another program's recording, or a moving face as a take"""

    bl_idname = "facemime.import_take"
    bl_label = "Import Take"

    filter_glob: StringProperty(
        default=";".join(f"*{suffix}" for suffix in (SUFFIX, *RECORDINGS, *MESHES, *PARAMETERS)), options={"HIDDEN"}
    )
    angles: EnumProperty(
        name="Angles",
        description="Unit of the rotation of the head in a table",
        items=(
            (AUTOMATIC, "Automatic", "Decided by the values"),
            (RADIANS, "Radians", "As Live Link Face writes them"),
            (DEGREES, "Degrees", "As some other programs write them"),
        ),
    )
    model: StringProperty(
        name="Model",
        description="File of the face model to which parameters belong: FLAME's .pkl, or GNM's .npz",
        subtype="FILE_PATH",
    )
    fps: FloatProperty(
        name="Frame Rate",
        description="Rate of numbered meshes, and of parameters and tables whose file states none",
        default=FPS,
        min=MIN_FPS,
        max=MAX_FPS,
    )

    def work(self, context: bpy.types.Context) -> None:
        """Read the file and add it to the list."""
        path = self.path
        if path.suffix.lower() in (*RECORDINGS, *MESHES, *PARAMETERS):
            model = Path(bpy.path.abspath(self.model)) if self.model else None
            is_moving = path.suffix.lower() not in RECORDINGS
            fps = self.fps if self.properties.is_property_set("fps") else None
            take = read_moving_face(path, fps, model) if is_moving else read_recording(path, self.angles, fps)
            takes_store.keep(context.scene, take, path.stem)
            _report_notes(self, take)
            return
        take = load_take(path)
        takes_store.add(context.scene, path, take)
        if warning := take.info.get("recovered"):
            report(self, Message.read(warning, VIDEO_CUT, PICTURES_SKIPPED), "WARNING")


class FACEMIME_OT_export_take(AsksForFileToWrite, OnTake, bpy.types.Operator):
    """Export the selected take to a file, or as a table of numbers"""

    bl_idname = "facemime.export_take"
    bl_label = "Export Take"

    filter_glob: StringProperty(default="*.facetake;*.csv", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        line, is_table = takes_store.chosen(context.scene), self.path.suffix.lower() == ".csv"
        take = takes_store.read(line, solved=is_table)
        if is_table:
            to_csv(take, self.path)
        else:
            save_take(take, self.path_ending(SUFFIX))


class FACEMIME_OT_pack_take(OnTake, bpy.types.Operator):
    """Pack the selected take into the .blend file, or unpack it"""

    bl_idname = "facemime.pack_take"
    bl_label = "Pack Take"

    def work(self, context: bpy.types.Context) -> None:
        line = takes_store.chosen(context.scene)
        if line.packed is None:
            takes_store.pack(line)
        else:
            report(self, "Written to {path}", path=takes_store.unpack(line))


class FACEMIME_OT_take_from_animation(WorksInSteps, OnHead, bpy.types.Operator):
    """Sample the active head over the frame range as a take, whether shape keys, bones or a cache move it"""

    bl_idname = "facemime.take_from_animation"
    bl_label = "Take from Animation"
    needs = (require_no_session, require_mesh)

    def status(self) -> str:
        return _("Facemime: sampling the animation; Esc to cancel")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Sample a frame at each step, and add the take to the list."""
        head = required_subject(context)
        sampling = Sampling(context.scene, head, head.name)
        with closing(iter(sampling)) as frames:
            for done in frames:
                yield done / len(sampling.frames)
        take = sampling.take()
        line = takes_store.keep(context.scene, take, head.name)
        count, name = len(take), line.name
        report(self, "{count} frames sampled as the take {name}", count=count, name=name)
        _report_notes(self, take)


def _report_notes(operator: bpy.types.Operator, take: Take) -> None:
    """Report what was decided when a take was made from something else."""
    for note in take.info.get("notes", []):
        report(operator, str(note))
