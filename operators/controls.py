"""Operators on the controls of a character's own rig: what they do to its face, and which of them help most."""

from collections.abc import Generator
from contextlib import closing

import bpy
from bpy.app.translations import pgettext_rpt as _
from bpy.props import IntProperty, StringProperty

from ..blender.controls.checks import loose_parts, measure_speed
from ..blender.controls.display import ControlSheet
from ..blender.controls.face_rig import add_face_rig
from ..blender.controls.probing import Learning
from ..blender.controls.stored import (
    has_controls,
    renew_stored,
    require_storable,
    rig_group,
    stored_map,
    write_controls,
    write_order,
)
from ..blender.heads.parts import ensure_bones
from ..blender.part_order import keep_order
from ..blender.rigs import read_rig
from ..blender.styles import has_examples
from ..core.errors import HeadError
from ..core.puppet.performer import Performance
from ..core.rigs.few import ControlOrder, face_units
from ..sessions.session import Session
from ..settings import takes_store
from ..settings.values import puppet_settings
from .shared import AsksForFileToWrite, OnHead, report, require_mesh, require_object_mode, required_subject
from .steps import WorksInSteps

_FRAMES = 52
"""Frames of a take for which controls are ranked, evenly spaced."""


class FACEMIME_OT_learn_controls(WorksInSteps, OnHead, bpy.types.Operator):
    """Move each control of the character's own rig a little, and learn what it does to the face"""

    bl_idname = "facemime.learn_controls"
    bl_label = "Learn Controls"
    needs = (require_object_mode, require_mesh)

    def status(self) -> str:
        return _("Facemime: learning the controls; Esc to cancel")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Learn control after control; in any case, each gets back the value that it had."""
        if (session := Session.running()) is not None:
            session.close()
        head = required_subject(context)
        ensure_bones(head)
        yield from learnt(self, head)


class FACEMIME_OT_add_face_rig(WorksInSteps, OnHead, bpy.types.Operator):
    """Give a head without a rig the face of Rigify, which must be enabled, and learn its controls"""

    bl_idname = "facemime.add_face_rig"
    bl_label = "Add Face Rig"
    needs = (require_object_mode, require_mesh)

    def status(self) -> str:
        return _("Facemime: adding a face rig; Esc to cancel")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Add the rig at once, and learn control after control."""
        if (session := Session.running()) is not None:
            session.close()
        head = required_subject(context)
        add_face_rig(head)
        yield 0.0
        yield from learnt(self, head)


def learnt(operator: bpy.types.Operator, head: bpy.types.Object) -> Generator[float, None, None]:
    """Learn the controls of a head; in any case, each gets back the value that it had."""
    require_storable(head)
    with closing(Learning(head)) as learning:
        for _step in learning.steps():
            yield learning.done / max(learning.total, 1)
        found = learning.result()
    write_controls(head, found)
    measure_speed(head, found)
    share = round(100.0 * rig_group(head).shown)
    report(operator, "{count} controls found; they can show {share} %", count=len(found.controls), share=share)
    if loose := loose_parts(head):
        report(operator, loose, "WARNING")


class FACEMIME_OT_rank_controls(WorksInSteps, OnHead, bpy.types.Operator):
    """Find out which controls of the rig help most to show a motion, so that few of them can be used"""

    bl_idname = "facemime.rank_controls"
    bl_label = "Rank Controls"

    take: IntProperty(
        name="Take",
        description="Index of the take in the list; -1 for ARKit's expressions",
        default=-1,
        min=-1,
        options={"SKIP_SAVE"},
    )

    def status(self) -> str:
        return _("Facemime: ranking the controls; Esc to cancel")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Add the control that helps most, again and again."""
        head = required_subject(context)
        found = stored_map(head)
        if found is None:
            raise HeadError(
                "The controls of {name} are not known. Use Learn Controls in the Head panel first.", name=head.name
            )
        motion, name = face_units(found.unit), ""
        if self.take >= 0:
            line = takes_store.at(context.scene, self.take)
            performance = Performance.of(takes_store.read(line), puppet_settings(context.scene.facemime))
            motion, name = performance.landmark_motion(read_rig(head), _FRAMES), line.name
        require_storable(head)
        order = ControlOrder(found, motion)
        yield from order.steps()
        write_order(head, order, name)
        report(self, "{count} controls ranked", count=len(found.controls))


class FACEMIME_OT_export_control_sheet(AsksForFileToWrite, OnHead, bpy.types.Operator):
    """Export a page that shows what each control of the rig that is used does to the face, with its range"""

    bl_idname = "facemime.export_control_sheet"
    bl_label = "Export Control Sheet"
    needs = (require_object_mode, require_mesh)

    filter_glob: StringProperty(default="*.html", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Pose the rig, and write the page."""
        path, sheet, manager = (
            self.path_ending(".html"),
            ControlSheet(required_subject(context)),
            context.window_manager,
        )
        if (session := Session.running()) is not None:
            session.close()
        manager.progress_begin(0.0, 1.0)
        try:
            for done in sheet.steps():
                manager.progress_update(done)
        finally:
            manager.progress_end()
        sheet.write(path)
        report(self, "Written to {path}", path=path)


def _opened(*_: object) -> None:
    """Let what files of earlier versions know by names be known when these are changed."""
    for head in bpy.data.objects:
        if head.library is None and (has_controls(head) or has_examples(head)):
            keep_order(head)
    renew_stored()


HANDLERS = {"load_post": _opened}
