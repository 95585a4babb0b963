"""Operators that calibrate, add and remove performers."""

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ..blender.messages import tooltip
from ..blender.stubs import OperatorResult
from ..sessions.calibrating import COUNTDOWN
from ..settings.performers import (
    add_performer,
    clear_file,
    forget,
    remove_performer,
    selected_performer,
    stored_performers,
)
from .puppet import require_puppet, required_puppet, running
from .shared import ReportsErrors, require

_POSES = (
    ("NEUTRAL", "Neutral", "Look straight at the camera for a second, with a relaxed face and the mouth closed"),
    ("RANGE", "Eyes and Mouth", "Within four seconds, close the eyes tightly and open the mouth wide"),
)


class FACEMIME_OT_calibrate(ReportsErrors, bpy.types.Operator):
    """Calibrate to the performer's face after a countdown"""

    bl_idname = "facemime.calibrate"
    bl_label = "Calibrate"
    bl_options = {"REGISTER"}
    needs = (require_puppet,)

    pose: EnumProperty(name="Pose", items=_POSES)
    countdown: FloatProperty(name="Countdown", default=COUNTDOWN, min=0.0, max=60.0, subtype="TIME_ABSOLUTE")

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Return what the performer has to do."""
        return next(tooltip(text) for pose, _, text in _POSES if pose == properties.pose)

    def work(self, context: bpy.types.Context) -> None:
        """Start the countdown."""
        required_puppet().calibrating.begin(range_of=self.pose == "RANGE", countdown=self.countdown)


class FACEMIME_OT_reset_calibration(ReportsErrors, bpy.types.Operator):
    """Remove the calibration of the selected performer, and everything learnt about them"""

    bl_idname = "facemime.reset_calibration"
    bl_label = "Reset Calibration"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a performer or a calibration to reset."""
        there = running() is not None or selected_performer(context.scene.facemime) is not None
        return require(cls, there, "There is no performer. One is added when you calibrate.")

    def work(self, context: bpy.types.Context) -> None:
        """Reset the calibration; a running puppet uses the next second as the neutral face."""
        if (performer := selected_performer(context.scene.facemime)) is not None:
            forget(performer)
        if (session := running()) is not None:
            session.worker.forget()


class FACEMIME_OT_add_performer(bpy.types.Operator):
    """Add a performer with a separate calibration"""

    bl_idname = "facemime.add_performer"
    bl_label = "Add Performer"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Name")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Add the performer and make it active."""
        add_performer(context.scene.facemime, self.name)
        return {"FINISHED"}


class FACEMIME_OT_remove_performer(ReportsErrors, bpy.types.Operator):
    """Remove the selected performer and their calibration"""

    bl_idname = "facemime.remove_performer"
    bl_label = "Remove Performer"

    def work(self, context: bpy.types.Context) -> None:
        """Remove the performer."""
        remove_performer(context.scene.facemime)


class FACEMIME_OT_clear_calibrations(ReportsErrors, bpy.types.Operator):
    """Remove the faces of all performers from the .blend file; they are kept until Blender quits"""

    bl_idname = "facemime.clear_calibrations"
    bl_label = "Remove Faces from File"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a stored calibration."""
        return require(cls, bool(stored_performers()), "No performer's face is stored in this .blend file")

    def work(self, context: bpy.types.Context) -> None:
        """Remove them from all scenes."""
        clear_file()
