"""Operators that prepare a mesh as a head: mark points, bind landmarks, propose regions, check, cut."""

from collections.abc import Generator

import bpy
from bpy.app.translations import pgettext_rpt as _
from bpy.props import BoolProperty, EnumProperty, IntProperty
from mathutils import Matrix

from ..blender.heads.binding import (
    check_object,
    move_landmark,
    placements,
    propose_head_regions,
    read_marks,
    search_character,
    selected_vertex,
    turn_note,
    write_marks,
)
from ..blender.heads.facegen import prepare_mouth
from ..blender.heads.family import character_of, hide_other_levels
from ..blender.heads.keyed import bind_keys
from ..blender.heads.look_keys import eyes_with_look_keys, look_keys_note
from ..blender.heads.neck import give_neck
from ..blender.heads.openings import open_eyes, open_lips
from ..blender.heads.painted_eyes import has_painted_skin, replace_eyes
from ..blender.heads.parts import open_border
from ..blender.heads.placing import FormerBinding
from ..blender.meshes import mesh_of, object_of, read_places
from ..blender.messages import translated
from ..blender.preview_scene import face_points, look_at_face
from ..blender.stubs import OperatorResult
from ..blender.view_layers import select_alone, show
from ..blender.viewports import is_hidden_by_others, show_alone, viewport_of
from ..core.errors import HeadError
from ..core.face.landmarks import from_ibug
from ..core.heads.bind import MARKS, Binding
from ..settings.panel_properties import keep_findings
from .place_points import CheckedBinding
from .shared import (
    OnCharacter,
    OnHead,
    OnMesh,
    chosen_character,
    report,
    require_character,
    require_left_edit_mode,
    require_mesh,
    require_object_mode,
    required_subject,
    subject,
)
from .steps import WorksInSteps, in_background

_CHECK_PANEL = "FACEMIME_PT_check"
"""The popup that shows the result of a check; it is in `ui`, which imports the operators."""


def _report_findings(operator: bpy.types.Operator, context: bpy.types.Context) -> bool:
    """Check the active head, report the problems and show them in the panels; return whether there are any."""
    findings = check_object(subject(context))
    keep_findings(context.window_manager, required_subject(context).name, findings)
    for finding in findings:
        operator.report({"WARNING"}, " ".join(map(translated, (finding.problem, finding.remedy))))
    return bool(findings)


def _choose(context: bpy.types.Context, head: bpy.types.Object) -> None:
    """Select a head alone, and show its character if the head is hidden."""
    if not head.visible_get():
        show([head, *character_of(head)])
    select_alone(context, head)


def _show_result(
    operator: bpy.types.Operator,
    context: bpy.types.Context,
    head: bpy.types.Object,
    before: dict[bpy.types.Object, Matrix],
) -> None:
    """Select a new head without its other levels of detail, and report if it was rotated since its world matrix was as
    in `before`.
    """
    _choose(context, head)
    for note in (turn_note(head, before), hide_other_levels(head)):
        if note:
            report(operator, note)


def _turn_to_face(context: bpy.types.Context) -> bool:
    """Turn the view to the face of the active head; return whether it is shown alone, as other objects hid it."""
    head, seen = required_subject(context), viewport_of(context)
    if seen is None:
        return False
    look_at_face(seen.view, head)
    space = context.space_data
    if seen.area != context.area or not isinstance(space, bpy.types.SpaceView3D) or space.local_view is not None:
        return False
    own = character_of(head)
    if not is_hidden_by_others(context, seen, face_points(head)[read_places(head)], own):
        return False
    show_alone(context, own)
    return True


class FACEMIME_OT_mark_point(OnMesh, bpy.types.Operator):
    """Mark the vertex selected in Edit Mode as a point of the face; mark at least four points, then use Find Face"""

    bl_idname = "facemime.mark_point"
    bl_label = "Mark Point"

    point: EnumProperty(
        name="Point",
        description="Left and right are the head's own",
        items=[(str(number), name, "") for number, name in MARKS.items()],
    )

    def work(self, context: bpy.types.Context) -> None:
        mesh, vertex = mesh_of(subject(context)), selected_vertex(required_subject(context))
        write_marks(mesh, read_marks(mesh) | {int(self.point): vertex})


class FACEMIME_OT_clear_marks(OnMesh, bpy.types.Operator):
    """Clear all marked points"""

    bl_idname = "facemime.clear_marks"
    bl_label = "Clear Marks"

    def work(self, context: bpy.types.Context) -> None:
        write_marks(mesh_of(subject(context)), {})


class FACEMIME_OT_bind_keys(OnCharacter, bpy.types.Operator):
    """Drive the character by its existing shape keys, such as ARKit's or VRM's, without landmarks"""

    bl_idname = "facemime.bind_keys"
    bl_label = "Use Its Shape Keys"
    needs = (require_object_mode, require_character)

    def work(self, context: bpy.types.Context) -> None:
        before = placements()
        head = bind_keys(chosen_character(context))
        _show_result(self, context, head, before)
        if not bpy.app.background and context.window is not None:
            _turn_to_face(context)
        report(self, "{name} is driven by its shape keys alone.", name=head.name)
        if note := look_keys_note(eyes_with_look_keys(head)):
            report(self, note)


class FACEMIME_OT_bind_landmarks(WorksInSteps, OnCharacter, bpy.types.Operator):
    """Find the face of the selected character, and create its regions; without marks, it may face along any axis"""

    bl_idname = "facemime.bind_landmarks"
    bl_label = "Find Face"
    needs = (require_object_mode, require_character)

    def status(self) -> str:
        return _("Facemime: searching for the face; Esc to cancel")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Search for the face in a thread, and bind what was found."""
        former, before = FormerBinding(context), placements()
        head, binding = yield from in_background(search_character(chosen_character(context)))
        _show_result(self, context, head, before)
        alone = self.in_window and _turn_to_face(context)
        self._report(context, binding, alone)
        if self.in_window:
            CheckedBinding.former = former
            CheckedBinding.alone = alone
            bpy.ops.facemime.adjust_landmarks("INVOKE_DEFAULT")  # type: ignore[attr-defined]  # registered at run time
        else:
            context.scene.facemime_steps.show_points = True

    def _report(self, context: bpy.types.Context, binding: Binding, alone: bool) -> None:
        memory = context.window_manager.facemime
        memory.unsure = required_subject(context).name if binding.wanted else ""
        memory.wanted = ",".join(map(str, binding.wanted))
        if alone:
            report(self, "Face found. It is shown alone in Local View, as other objects hide it. Check the points")
        else:
            report(self, "Face found. Check the points")
        if binding.doubt:
            report(self, binding.doubt, "WARNING")
        for finding in binding.findings:
            self.report({"WARNING"}, " ".join(map(translated, (finding.problem, finding.remedy))))
        if note := give_neck(required_subject(context)):
            report(self, note)
        _report_findings(self, context)


class FACEMIME_OT_set_landmark(OnMesh, bpy.types.Operator):
    """Move one landmark to the vertex selected in Edit Mode"""

    bl_idname = "facemime.set_landmark"
    bl_label = "Set Landmark"

    number: IntProperty(name="Landmark", description="iBUG number of the landmark, except 60 and 64", min=0, max=67)

    def work(self, context: bpy.types.Context) -> None:
        if self.number in (60, 64):
            raise HeadError("Landmarks 60 and 64 are not used. Choose another number.")
        obj = required_subject(context)
        move_landmark(obj, int(from_ibug([self.number])[0]), selected_vertex(obj))


class FACEMIME_OT_propose_regions(OnMesh, bpy.types.Operator):
    """Replace the three regions with weights derived from the landmarks and the openings of the eyes and mouth"""

    bl_idname = "facemime.propose_regions"
    bl_label = "Reset Regions"
    needs = (require_left_edit_mode, require_mesh)

    def work(self, context: bpy.types.Context) -> None:
        propose_head_regions(required_subject(context))


class FACEMIME_OT_check_head(OnMesh, bpy.types.Operator):
    """Check this head for problems, and list its parts and bones"""

    bl_idname = "facemime.check_head"
    bl_label = "Check Head"
    bl_options = {"REGISTER"}

    def work(self, context: bpy.types.Context) -> None:
        if not _report_findings(self, context):
            report(self, "{name} is ready to be driven", name=required_subject(context).name)
        if not bpy.app.background and context.window is not None:
            bpy.ops.wm.call_panel("INVOKE_DEFAULT", name=_CHECK_PANEL, keep_open=True)


class FACEMIME_OT_open_lips(OnHead, bpy.types.Operator):
    """Cut the mesh between joined lips, such as those of a scan, so that the mouth can open, and add a dark pocket"""

    bl_idname = "facemime.open_lips"
    bl_label = "Open Lips"

    def work(self, context: bpy.types.Context) -> None:
        head = subject(context)
        hollow = len(open_border(object_of(head))) > 0
        count = open_lips(head)
        if hollow:
            report(self, "A dark pocket added behind the lips")
        else:
            report(self, "{count} edges cut between the lips, and a dark pocket added behind them", count=count)
        _report_findings(self, context)


class FACEMIME_OT_open_eyes(OnHead, bpy.types.Operator):
    """Cut the mesh along eyelids that are joined to the eyes, such as those of a scan, so that they can close"""

    bl_idname = "facemime.open_eyes"
    bl_label = "Open Eyes"

    eyeballs: BoolProperty(
        name="Eyeballs That Turn",
        description="Put eyeballs, which follow the gaze, in place of the eyes that are painted on the mesh",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Put eyeballs in place of eyes that a texture shows, unless it was chosen not to."""
        if not self.properties.is_property_set("eyeballs"):
            self.eyeballs = has_painted_skin(subject(context))
        return self.execute(context)

    def work(self, context: bpy.types.Context) -> None:
        head = subject(context)
        if self.eyeballs:
            prepare_mouth(required_subject(context))
        count = replace_eyes(head) if self.eyeballs else open_eyes(head)
        report(
            self,
            "Cut along the lids of {count} eyes. If the cut misses the lids, undo it, mark the corners of the eyes, "
            "and find the face again",
            count=count,
        )
        _report_findings(self, context)
