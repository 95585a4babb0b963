"""The box at the top of the tab: head, source, the next step as a large button, and status."""

import sys

import bpy

from ..blender.heads.family import character_in, face_candidates, known_keys
from ..blender.messages import interface as _
from ..blender.stubs import Icon
from ..core.puppet.camera import explain_failure
from ..core.puppet.camera_list import list_cameras
from ..operators.place_points import placing_on
from ..operators.puppet import running
from ..operators.shared import heads_in, subject
from ..sessions.live import LiveSession
from ..sessions.show import TakeShow
from ..sessions.tracking import TrackingSession
from ..settings.panel_properties import problem_of
from ..settings.preferences import preferences
from ..settings.properties import FacemimeSource
from ..settings.values import FILE_OF, whole_file
from .sidebar import Sidebar, labels, place, side_by_side
from .status import draw_progress, summary


class FACEMIME_PT_start(Sidebar, bpy.types.Panel):
    """The requirements of a puppet, from top to bottom, with the next step as a large button.

    It has a header: Blender draws the texts of other panels on the viewport, where some themes make them unreadable.
    """

    bl_label = "Start"
    bl_order = place("start")
    bl_options = set()

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the box."""
        session, heads = running(), heads_in(context)
        character = None if heads else character_in(context)
        layout = self.layout
        column = layout.column(align=True)
        row = column.row(align=True)
        row.prop(
            context.window_manager,
            "facemime_picked",
            text="",
            icon="MONKEY",
            placeholder=_name(heads, character),
            translate=False,
        )
        row.menu("FACEMIME_MT_add", text="", icon="ADD")
        source = context.scene.facemime.source
        column.prop(source, "kind", text="")
        if source.kind in FILE_OF:
            column.prop(source, FILE_OF[source.kind], text="")
        row = layout.row(align=True)
        row.scale_y = 1.6
        if placing_on(subject(context)) is not None:
            row.operator("facemime.accept_points", icon="CHECKMARK", depress=True)
            row.operator("facemime.discard_points", icon="LOOP_BACK")
        elif session is not None:
            row.operator("facemime.stop_puppet", text="Stop", icon="SNAP_FACE", depress=True)
            _draw_record(row, session)
        elif (tracking := TrackingSession.running()) is not None:
            draw_progress(row, tracking)
        elif TakeShow.running() is not None:
            row.operator("facemime.show_take", text="Stop", icon="SNAP_FACE", depress=True)
        elif heads and source.kind == "VIDEO":
            _draw_video(layout, row, source)
        elif heads:
            row.operator("facemime.puppet", text="Start", icon="PLAY")
            row.operator("facemime.record_take", text="Record", icon="REC")
        elif character is not None:
            _draw_binding(layout, context, row, character)
        else:
            row.operator("facemime.add_head", text="Add Head", icon="MONKEY")
            row.operator("facemime.bind_landmarks", text="Find Face", icon="VIEWZOOM")
        _draw_take(layout, context, session)
        text, icon = _next_step(context, heads, character) if session is None else summary(session)
        labels(layout, context, text, icon)


def _draw_video(layout: bpy.types.UILayout, row: bpy.types.UILayout, source: FacemimeSource) -> None:
    """Draw the buttons for a video: every frame is tracked and baked, or it is played live."""
    button = row.operator("facemime.puppet_video", text="Track and Bake", icon="FILE_MOVIE")
    if path := whole_file(source):
        button.filepath = path
    row = layout.row(align=True)
    row.operator("facemime.puppet", text="Play Live", icon="PLAY")
    row.operator("facemime.record_take", text="Record", icon="REC")


def _draw_take(layout: bpy.types.UILayout, context: bpy.types.Context, session: LiveSession | None) -> None:
    """Draw what can be done with a take that was just recorded."""
    takes = context.scene.facemime_takes
    recording = session is not None and (session.recorder.recording is not None or session.recorder.delayed is not None)
    if not context.window_manager.facemime.recorded or recording or not 0 <= takes.index < len(takes.items):
        return
    column = layout.column(align=True)
    column.label(text=takes.items[takes.index].name, icon="ACTION", translate=False)
    row = side_by_side(column, context)
    row.operator("facemime.show_take", text="Preview", icon="PLAY")
    row.operator("facemime.trim_take", text="Trim", icon="ARROW_LEFTRIGHT")
    row.operator("facemime.bake_take", text="Bake", icon="ACTION")


def _name(heads: list[bpy.types.Object], character: bpy.types.Object | None) -> str:
    """Return the name of the head or character, or their number."""
    if len(heads) > 1:
        return _("{count} heads").format(count=len(heads))
    if heads:
        return heads[0].name
    return _("No head yet") if character is None else face_candidates(character)[0].name


def _draw_binding(
    layout: bpy.types.UILayout, context: bpy.types.Context, row: bpy.types.UILayout, character: bpy.types.Object
) -> None:
    """Draw the ways to drive a character: by the known shape keys that it has, or by its face."""
    if (table := known_keys(character)) is not None:
        text = _("Use Its {count} {name} Keys").format(count=len(table.keys), name=table.short_name)
        row.operator("facemime.bind_keys", text=text, icon="SHAPEKEY_DATA", translate=False)
        labels(layout, context, table.summary())
        row = layout.row(align=True)
    row.operator("facemime.bind_landmarks", text="Find Face", icon="VIEWZOOM")
    row.operator("facemime.mark_face", text="", icon="PIVOT_CURSOR")


def _draw_record(layout: bpy.types.UILayout, session: LiveSession) -> None:
    if session.recorder.delayed is not None:
        layout.operator("facemime.record_take", text="Cancel", icon="X", depress=True)
        return
    recording = session.recorder.recording is not None
    layout.operator(
        "facemime.record_take", text="Stop Recording" if recording else "Record", icon="REC", depress=recording
    )


def _next_step(
    context: bpy.types.Context, heads: list[bpy.types.Object], character: bpy.types.Object | None
) -> tuple[str, Icon]:
    """Return the next step, and an icon."""
    if context.mode == "EDIT_MESH":
        return _("Leave Edit Mode first"), "INFO"
    if (placing := placing_on(subject(context))) is not None:
        return _("Click the point that is shown") if placing.asked else _("Drag misplaced points"), "INFO"
    if TrackingSession.running() is not None:
        return _("Tracking the whole video"), "TIME"
    if TakeShow.running() is not None:
        return _("A take is shown"), "PLAY"
    if character is not None:
        known = known_keys(character) is not None
        return _("It can be driven at once, by its shape keys") if known else _("Find its face first"), "INFO"
    if not heads:
        return _("Add a head, or select a character"), "INFO"
    source = context.scene.facemime.source
    if source.kind in FILE_OF and not getattr(source, FILE_OF[source.kind]):
        asked = {
            "VIDEO": _("Choose the video above"),
            "PICTURES": _("Choose the folder above"),
            "TAKE": _("Choose the take above"),
        }
        return asked[source.kind], "INFO"
    if problem := problem_of(context) or _absent_camera(source):
        return problem, "ERROR"
    if context.window_manager.facemime.recorded:
        return _("Recorded. Preview it, trim it, or bake it to the head"), "CHECKMARK"
    if source.kind == "VIDEO":
        return _("Track and Bake uses every frame; played live, frames are skipped"), "INFO"
    return _("Ready"), "CHECKMARK"


def _absent_camera(source: FacemimeSource) -> str:
    """Return the message for a numbered camera that Linux does not have; other systems cannot be asked."""
    device = preferences().camera.strip()
    if source.kind != "CAMERA" or sys.platform != "linux" or not device.isdecimal():
        return ""
    present = any(camera.device == device for camera in list_cameras())
    return "" if present else explain_failure("closed", device)


class FACEMIME_MT_add(bpy.types.Menu):
    """Add a head, or find the face of the selected character"""

    bl_label = "Add Head"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the ways to add or find a head."""
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        plain = layout.operator_menu_enum("facemime.add_head", "person", text=_("Head"), icon="MONKEY")
        plain.units = False
        keyed = layout.operator_menu_enum(
            "facemime.add_head", "person", text=_("Head with ARKit Keys"), icon="SHAPEKEY_DATA"
        )
        keyed.units = True
        layout.operator("facemime.import_facegen", text="FaceGen Head", icon="IMPORT")
        layout.separator()
        layout.operator("facemime.bind_landmarks", text="Find Face of Selected Character", icon="VIEWZOOM")
        layout.operator("facemime.mark_face", text="Find Face from Marks...", icon="PIVOT_CURSOR")
