"""Calibrate a performer, and say who performs."""

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ..sessions.live import COUNTDOWN
from ..settings.values import add_performer, remove_performer
from .puppet import running
from .shared import ReportsErrors


class FACEMIME_OT_calibrate(ReportsErrors, bpy.types.Operator):
    """After a countdown, learn how this performer's face looks"""

    bl_idname = "facemime.calibrate"
    bl_label = "Calibrate"
    bl_options = {"REGISTER"}

    pose: EnumProperty(
        name="Pose",
        items=(
            ("NEUTRAL", "Neutral", "Look straight at the camera with a relaxed face, mouth closed, for a second"),
            ("RANGE", "Eyes and Mouth", "In four seconds, shut the eyes tight and open the mouth wide"),
        ),
    )
    countdown: FloatProperty(name="Countdown", default=COUNTDOWN, min=0.0, max=60.0, subtype="TIME_ABSOLUTE")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while a puppet runs."""
        if running() is None:
            cls.poll_message_set("Start the puppet first: step Puppet, below")
            return False
        return True

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """What the performer does meanwhile."""
        pose = cls.bl_rna.properties["pose"].enum_items if "pose" in cls.bl_rna.properties else {}
        item = pose.get(properties.pose)
        return cls.__doc__ if item is None else item.description

    def work(self, context: bpy.types.Context) -> set[str]:
        """Begin the countdown."""
        running().calibrate(range_of=self.pose == "RANGE", countdown=self.countdown)
        return {"FINISHED"}


class FACEMIME_OT_add_performer(bpy.types.Operator):
    """Add a performer, who has a calibration of their own"""

    bl_idname = "facemime.add_performer"
    bl_label = "Add Performer"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Name")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add and choose the performer."""
        add_performer(context.scene.facemime, self.name)
        return {"FINISHED"}


class FACEMIME_OT_remove_performer(ReportsErrors, bpy.types.Operator):
    """Remove the performer who is chosen, with the calibration"""

    bl_idname = "facemime.remove_performer"
    bl_label = "Remove Performer"
    bl_options = {"REGISTER", "UNDO"}

    def work(self, context: bpy.types.Context) -> set[str]:
        """Remove the performer."""
        remove_performer(context.scene.facemime)
        return {"FINISHED"}


CLASSES = (FACEMIME_OT_calibrate, FACEMIME_OT_add_performer, FACEMIME_OT_remove_performer)
