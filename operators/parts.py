"""Operators that change the parts and regions of a character, and the bones that follow the pose of its head."""

from collections.abc import Generator
from dataclasses import replace

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as _
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..blender.characters import read_bones, read_kinds, set_part, write_bones
from ..blender.heads.binding import propose_head_regions
from ..blender.heads.expression_keys import making_expression_keys
from ..blender.heads.family import armature_of
from ..blender.heads.painting import mirror_painted, paint_region, smooth_painted
from ..blender.heads.parts import forget_parts, sort_again
from ..blender.meshes import is_head, mesh_of, posed_bones
from ..blender.names import HEAD_PROPERTY
from ..blender.part_order import remove_from_character
from ..blender.stubs import OperatorResult
from ..core.bake.key_sets import KEY_SETS
from ..core.errors import HeadError, SourceError, messages
from ..core.heads.rig import PART_NAMES, Part
from ..core.takes.take import Take
from ..sessions.session import Session
from ..settings import takes_store
from .shared import OnHead, ReportsErrors, report, require, require_mesh, require_object_mode, required_subject, subject
from .steps import WorksInSteps, in_background

_DESCRIPTIONS = messages(
    {
        Part.SKIN: "Skin of the face, which the landmarks move",
        Part.ON_HEAD: "Rides on the head, such as hair, glasses and a hat",
        Part.ON_SKIN: "Rides on the skin, such as lashes, brows and a beard",
        Part.EYE_RIGHT: "The character's right eye, which follows the gaze",
        Part.EYE_LEFT: "The character's left eye, which follows the gaze",
        Part.TEETH_UPPER: "Upper teeth, which stay with the head",
        Part.TEETH_LOWER: "Lower teeth and the tongue, which follow the jaw",
    }
)
_ITEMS = [(part.name, PART_NAMES[part], _DESCRIPTIONS[part]) for part in Part]
BONES = messages({"head": "Head Bone", "eye_right": "Right Eye Bone", "eye_left": "Left Eye Bone"})
"""Labels of the bones that follow the pose."""
_NO_BONE = "NONE"
_bone_items: list[tuple[str, str, str]] = []
"""Blender keeps no copy of the items of a dynamic enumeration."""


class FACEMIME_OT_set_part(ReportsErrors, bpy.types.Operator):
    """Assign an object, or the selected vertices in Edit Mode, to a part of the character"""

    bl_idname = "facemime.set_part"
    bl_label = "Set Part"

    part: EnumProperty(name="Part", items=_ITEMS)
    name: StringProperty(
        name="Object", description="Object to change; if empty, the active object", options={"SKIP_SAVE"}
    )
    before: StringProperty(
        name="Before",
        description="Current part of the vertices to change; if empty, all vertices of the object",
        options={"SKIP_SAVE"},
    )

    def work(self, context: bpy.types.Context) -> None:
        """Change the part of the vertices."""
        obj = bpy.data.objects.get(self.name) if self.name else context.active_object
        if obj is None or obj.type != "MESH":
            raise HeadError("There is no such mesh. Select a mesh of the character.")
        editing = obj.mode == "EDIT"
        if editing:
            bpy.ops.object.mode_set(mode="OBJECT")
        try:
            chosen = np.ones(len(mesh_of(obj).vertices), dtype=bool)
            if editing:
                mesh_of(obj).vertices.foreach_get("select", chosen)
            elif self.before:
                chosen = read_kinds(mesh_of(obj)) == Part[self.before]
            if not chosen.any():
                raise HeadError("No vertex is selected. Select those of the part.")
            set_part(obj, Part[self.part], chosen)
        finally:
            if editing:
                bpy.ops.object.mode_set(mode="EDIT")
        report(self, "{chosen} vertices changed", chosen=int(chosen.sum()))


class FACEMIME_OT_add_part(OnHead, bpy.types.Operator):
    """Add the other selected meshes to the character of the active head"""

    bl_idname = "facemime.add_part"
    bl_label = "Add Selected"

    part: EnumProperty(name="Part", items=_ITEMS[1:])

    def work(self, context: bpy.types.Context) -> None:
        head = subject(context)
        others = [obj for obj in context.selected_objects if obj != head and obj.type == "MESH" and not is_head(obj)]
        if not others:
            raise HeadError("No other mesh is selected. Select the parts, then the head.")
        for obj in others:
            obj[HEAD_PROPERTY] = head
            set_part(obj, Part[self.part], np.ones(len(mesh_of(obj).vertices), dtype=bool))
        report(self, "{others} meshes added", others=len(others))


class FACEMIME_OT_remove_part(ReportsErrors, bpy.types.Operator):
    """Remove an object from the character, so that the performance does not move it"""

    bl_idname = "facemime.remove_part"
    bl_label = "Remove from Character"

    name: StringProperty(name="Object", options={"SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> None:
        """Remove the object."""
        obj = bpy.data.objects.get(self.name)
        if obj is None or HEAD_PROPERTY not in obj:
            raise HeadError("There is no such mesh. Select a mesh of the character.")
        set_part(obj, Part.SKIN, np.ones(len(mesh_of(obj).vertices), dtype=np.bool_))
        remove_from_character(obj)


class FACEMIME_OT_find_parts(OnHead, bpy.types.Operator):
    """Sort the meshes of the character into parts again, find its bones, and create its regions"""

    bl_idname = "facemime.find_parts"
    bl_label = "Find Parts"

    def work(self, context: bpy.types.Context) -> None:
        head = required_subject(context)
        forget_parts(head)
        sort_again(head)
        propose_head_regions(head)


def _items_of_bones(operator: bpy.types.Operator, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    head = None if context is None else subject(context)
    armature = None if head is None else read_bones(head)[0] or armature_of(head)
    names = [] if armature is None else [bone.name for bone in posed_bones(armature)]
    _bone_items[:] = [(_NO_BONE, "None", "No bone"), *((name, name, "") for name in names)]
    return _bone_items


class FACEMIME_OT_set_bone(OnHead, bpy.types.Operator):
    """Choose the bone that follows the pose of the head or the gaze of an eye"""

    bl_idname = "facemime.set_bone"
    bl_label = "Set Bone"
    bl_property = "bone"

    needs_landmarks = False

    target: EnumProperty(name="Target", items=[(key, label, "") for key, label in BONES.items()])
    bone: EnumProperty(name="Bone", items=_items_of_bones)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Open a list of the bones to search in."""
        context.window_manager.invoke_search_popup(self)
        return {"RUNNING_MODAL"}

    def work(self, context: bpy.types.Context) -> None:
        head = required_subject(context)
        stored, bones = read_bones(head)
        armature = stored or armature_of(head)
        if armature is None:
            raise HeadError("{name} has no armature. Parent it to one, or use an Armature modifier.", name=head.name)
        name = "" if self.bone == _NO_BONE else self.bone
        write_bones(head, armature, replace(bones, **{self.target: name}))


class FACEMIME_OT_make_expression_keys(WorksInSteps, OnHead, bpy.types.Operator):
    """Add a set of shape keys, such as ARKit's, to all meshes of the face; existing keys are kept"""

    bl_idname = "facemime.make_expression_keys"
    bl_label = "Make Expression Keys"
    needs = (require_object_mode, require_mesh)

    keys: EnumProperty(  # type: ignore[assignment]  # hides that of bpy_struct
        name="Keys",
        description="Programs that the keys are for",
        items=[(name, keys.label, "") for name, keys in KEY_SETS.items()],
    )
    refine: BoolProperty(
        name="Refine by Takes",
        description="Let ARKit's keys reproduce the live motion in the takes in the list as well as they can",
        default=True,
    )

    def status(self) -> str:
        return _("Facemime: making shape keys; Esc to cancel")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        """Make the keys in a thread, and add them."""
        if (session := Session.running()) is not None:
            session.close()
        takes = self._takes(context) if self.refine else []
        made = yield from in_background(making_expression_keys(subject(context), KEY_SETS[self.keys], takes))
        for finding in made.findings:
            report(self, finding)
        report(self, made.summary())

    def _takes(self, context: bpy.types.Context) -> list[Take]:
        """Return the takes in the list; those that cannot be read are reported."""
        takes = []
        for line in context.scene.facemime_takes.items:
            try:
                takes.append(takes_store.read(line))
            except SourceError as error:
                report(self, str(error), "WARNING")
        return takes


class FACEMIME_OT_paint_region(OnHead, bpy.types.Operator):
    """Paint the weights of this region on the active head"""

    bl_idname = "facemime.paint_region"
    bl_label = "Paint Region"

    region: EnumProperty(
        name="Region",
        items=(
            ("UPPER", "Upper", "Brows and upper eyelids"),
            ("MIDDLE", "Middle", "Lower eyelids, cheeks, nose and upper lip"),
            ("LOWER", "Lower", "Lower lip, chin and jaw"),
        ),
    )

    def work(self, context: bpy.types.Context) -> None:
        paint_region(context, required_subject(context), ("UPPER", "MIDDLE", "LOWER").index(self.region))


class FACEMIME_OT_leave_painting(ReportsErrors, bpy.types.Operator):
    """Return to Object Mode"""

    bl_idname = "facemime.leave_painting"
    bl_label = "Finish Painting"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require Weight Paint Mode."""
        return require(cls, context.mode == "PAINT_WEIGHT", "Only available in Weight Paint Mode")

    def work(self, context: bpy.types.Context) -> None:
        """Switch to Object Mode."""
        bpy.ops.object.mode_set(mode="OBJECT")


class FACEMIME_OT_mirror_regions(OnHead, bpy.types.Operator):
    """Mirror the regions of one half of the face to the other"""

    bl_idname = "facemime.mirror_regions"
    bl_label = "Mirror Regions"

    source: EnumProperty(
        name="Direction",
        description="Direction in which the regions are copied; left and right are the head's own",
        items=(("left", "Left to Right", ""), ("right", "Right to Left", "")),
    )

    def work(self, context: bpy.types.Context) -> None:
        mirror_painted(required_subject(context), "left" if self.source == "left" else "right")


class FACEMIME_OT_smooth_regions(OnHead, bpy.types.Operator):
    """Smooth the borders of the regions, except between the lips and between the eyelids"""

    bl_idname = "facemime.smooth_regions"
    bl_label = "Smooth Borders"

    repeat: IntProperty(name="Repeat", default=3, min=1, max=50)

    def work(self, context: bpy.types.Context) -> None:
        smooth_painted(required_subject(context), self.repeat)
