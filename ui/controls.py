"""Panel Controls: the controls of the character's own rig that were learnt."""

import bpy

from ..blender.controls.stored import has_controls, rig_group
from ..blender.messages import CONTEXT
from ..blender.messages import interface as _
from ..core.errors import messages
from ..core.rigs.rig_map import REGIONS
from ..operators.shared import required_subject
from .sidebar import OnHead, labels

_REGIONS = messages({"Brows": "Brows", "Eyes": "Eyes", "Nose": "Nose", "Mouth": "Mouth", "Jaw": "Jaw"})
"""Names of the regions in the interface."""


class FACEMIME_PT_controls(OnHead, bpy.types.Panel):
    """The controls of the character's own rig."""

    bl_label = "Controls"
    bl_parent_id = "FACEMIME_PT_head"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, head = self.layout, required_subject(context)
        known = has_controls(head)
        layout.operator("facemime.learn_controls", text="Learn Again" if known else "Learn Controls", icon="POSE_HLT")
        if not known:
            labels(layout, context, "Bones and sliders of the character's own rig, which a take can be baked to")
            return
        settings = rig_group(head)
        text = _("{count} controls found; they can show {share} %")
        share = round(100.0 * settings.shown)
        layout.label(text=text.format(count=len(settings.controls), share=share), translate=False)
        for region in REGIONS:
            if own := [item for item in settings.controls if item.region == region]:
                column = layout.column(align=True)
                column.label(text=_REGIONS[region], text_ctxt=CONTEXT)
                for item in own:
                    column.prop(item, "use", text=item.name, translate=False)
