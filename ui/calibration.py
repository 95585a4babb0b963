"""Panel Calibration: the performers and their calibrations."""

import bpy

from ..blender.stubs import Icon
from ..operators.puppet import running
from ..sessions.countdown import COUNTDOWN
from ..settings.performers import calibration_of, stored_performers
from ..settings.properties import FacemimePerformer
from .sidebar import Sidebar, draw_list, labels, place
from .status import countdown_text


class FACEMIME_UL_performers(bpy.types.UIList):
    """List of performers, with a tick for those that are calibrated."""

    def draw_item(  # type: ignore[override]  # Blender passes as many arguments as there are
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: bpy.types.bpy_struct,
        item: FacemimePerformer,
        icon: int,
        active_data: bpy.types.bpy_struct,
        active_property: str,
    ) -> None:
        """Draw one performer."""
        layout.prop(item, "name", text="", emboss=False, icon="CHECKMARK" if calibration_of(item) else "USER")


class FACEMIME_PT_calibration(Sidebar, bpy.types.Panel):
    """List of performers and the calibration buttons."""

    bl_label = "Calibration"
    bl_order = place(__name__)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings, session = self.layout, context.scene.facemime, running()
        buttons: dict[str, Icon] = {"add_performer": "ADD", "remove_performer": "REMOVE"}
        draw_list(layout, "FACEMIME_UL_performers", settings, ("performers", "performer"), 2, buttons)
        if session is None:
            labels(layout, context, "Fits the puppet to your face. Start the puppet first", "INFO")
        column = layout.column(align=True)
        column.operator("facemime.calibrate", text="Neutral Face", icon="USER").pose = "NEUTRAL"
        column.operator("facemime.calibrate", text="Eyes and Mouth", icon="HIDE_OFF").pose = "RANGE"
        column.operator("facemime.reset_calibration", text="Reset", icon="LOOP_BACK")
        layout.prop(settings, "learn")
        layout.prop(settings, "keep_calibrations")
        if stored_performers():
            layout.operator("facemime.clear_calibrations", icon="TRASH")
        if session is None:
            return
        if session.calibrating.current is not None:
            passed = 1.0 - min(session.calibrating.current.left / COUNTDOWN, 1.0)
            layout.progress(factor=passed, text=countdown_text(session), translate=False)
        elif (quality := session.worker.quality) is not None:
            labels(layout, context, quality.message, "CHECKMARK" if quality.good else "ERROR")


CLASSES = (FACEMIME_UL_performers, FACEMIME_PT_calibration)
