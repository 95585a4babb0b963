"""Make a mesh of your own a head: mark points, bind landmarks, propose regions, check."""

import bpy
from bpy.props import EnumProperty, IntProperty

from ..blender.heads.binding import (
    bind_head,
    check_object,
    clear_marks,
    move_landmark,
    picked_vertex,
    propose_head_regions,
    write_mark,
)
from ..blender.heads.eyes import open_eyes
from ..blender.heads.lips import open_lips
from ..core.heads.binding import MARKS
from ..core.landmarks import from_ibug
from ..settings.panel_properties import keep_findings
from .shared import OnHead, OnMesh, in_object_mode

_STRANGE = 0.07
"""Strain of a binding above which it may well be of something else than a face."""


def tell_findings(operator: bpy.types.Operator, context: bpy.types.Context) -> bool:
    """Check the active head, report what is wrong and let the panels show it; whether anything is."""
    findings = check_object(context.active_object)
    keep_findings(context.window_manager, context.active_object.name, findings)
    for finding in findings:
        operator.report({"WARNING"}, f"{finding.problem} {finding.remedy}")
    return bool(findings)


class FACEMIME_OT_mark_point(OnMesh, bpy.types.Operator):
    """Say which point of the face the selected vertex is, in Edit mode; mark four or more, then bind"""

    bl_idname = "facemime.mark_point"
    bl_label = "Mark Point"
    bl_options = {"REGISTER", "UNDO"}

    point: EnumProperty(
        name="Point",
        description="Left and right are the head's own",
        items=[(str(number), name.capitalize(), "") for number, name in MARKS.items()],
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        write_mark(context.active_object.data, int(self.point), picked_vertex(context.active_object))
        return {"FINISHED"}


class FACEMIME_OT_clear_marks(OnMesh, bpy.types.Operator):
    """Forget the marked points"""

    bl_idname = "facemime.clear_marks"
    bl_label = "Clear Marks"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        clear_marks(context.active_object.data)
        return {"FINISHED"}


class FACEMIME_OT_bind_landmarks(OnMesh, bpy.types.Operator):
    """Find the 66 landmarks of the active mesh and propose its regions; without marks it may face along any axis"""

    bl_idname = "facemime.bind_landmarks"
    bl_label = "Bind Landmarks"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a mesh active, in Object mode."""
        return in_object_mode(cls, context) and super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        binding = bind_head(context.active_object)
        fit = f"{100 * binding.residual:.1f} % of the eye distance off the template"
        told = f"66 landmarks bound, {fit}{', symmetric' if binding.symmetric else ''}"
        if binding.strain > _STRANGE:
            told += ". This is an unusual face: look where they are, and mark points if they are not on it"
        if binding.body:
            told += ". The whole body would turn with the head: let a bone take its pose in Puppet > Head and Eyes"
        self.report({"WARNING"} if binding.strain > _STRANGE else {"INFO"}, told)
        tell_findings(self, context)
        return {"FINISHED"}


class FACEMIME_OT_set_landmark(OnMesh, bpy.types.Operator):
    """Bind one landmark to the vertex that is selected in Edit mode"""

    bl_idname = "facemime.set_landmark"
    bl_label = "Set Landmark"
    bl_options = {"REGISTER", "UNDO"}

    number: IntProperty(name="Landmark", description="Its iBUG number (not 60 and 64)", min=0, max=67)

    def work(self, context: bpy.types.Context) -> set[str]:
        if self.number in (60, 64):
            self.report({"ERROR"}, "Landmarks 60 and 64 are not used. Choose another number.")
            return {"CANCELLED"}
        obj = context.active_object
        move_landmark(obj, int(from_ibug([self.number])[0]), picked_vertex(obj))
        return {"FINISHED"}


class FACEMIME_OT_propose_regions(OnMesh, bpy.types.Operator):
    """Paint the three regions anew from the landmarks and the openings of eyes and mouth"""

    bl_idname = "facemime.propose_regions"
    bl_label = "Propose Regions"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not in Edit mode, where vertex groups cannot be written."""
        if context.mode == "EDIT_MESH":
            cls.poll_message_set("Leave Edit mode first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        propose_head_regions(context.active_object)
        return {"FINISHED"}


class FACEMIME_OT_check_head(OnMesh, bpy.types.Operator):
    """Say what would keep the active mesh from being puppeted well, and what to do"""

    bl_idname = "facemime.check_head"
    bl_label = "Check Head"
    bl_options = {"REGISTER"}

    def work(self, context: bpy.types.Context) -> set[str]:
        if not tell_findings(self, context):
            self.report({"INFO"}, f"{context.active_object.name} is ready to be puppeted")
        return {"FINISHED"}


class FACEMIME_OT_open_lips(OnHead, bpy.types.Operator):
    """Cut the mesh between lips that are one skin, as a scan's are, so that the mouth can open"""

    bl_idname = "facemime.open_lips"
    bl_label = "Open Lips"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        count = open_lips(context.active_object)
        self.report({"INFO"}, f"{count} edges cut between the lips, and a dark pocket put behind them")
        tell_findings(self, context)
        return {"FINISHED"}


class FACEMIME_OT_open_eyes(OnHead, bpy.types.Operator):
    """Cut out eyes that are one skin with their lids, as a scan's are, so that the lids can shut over them"""

    bl_idname = "facemime.open_eyes"
    bl_label = "Open Eyes"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        count = open_eyes(context.active_object)
        advice = "If the cut is beside the lids, undo it, mark the corners of the eyes, and bind again"
        self.report({"INFO"}, f"Cut along the lids of {count} eyes. {advice}")
        tell_findings(self, context)
        return {"FINISHED"}


CLASSES = (
    FACEMIME_OT_mark_point,
    FACEMIME_OT_clear_marks,
    FACEMIME_OT_bind_landmarks,
    FACEMIME_OT_set_landmark,
    FACEMIME_OT_propose_regions,
    FACEMIME_OT_check_head,
    FACEMIME_OT_open_lips,
    FACEMIME_OT_open_eyes,
)
