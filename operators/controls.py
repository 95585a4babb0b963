"""Operator that learns what the controls of a character's own rig do to its face."""

from collections.abc import Generator
from contextlib import closing

import bpy
from bpy.app.translations import pgettext_rpt as _

from ..blender.controls.probing import Learning
from ..blender.controls.stored import rig_group, write_controls
from ..blender.heads.parts import ensure_bones
from ..sessions.session import Session
from .shared import OnHead, report, require_mesh, require_object_mode, required_subject
from .steps import WorksInSteps


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
        with closing(Learning(head)) as learning:
            for _step in learning.steps():
                yield learning.done / max(learning.total, 1)
            found = learning.result()
        write_controls(head, found)
        share = round(100.0 * rig_group(head).shown)
        report(self, "{count} controls found; they can show {share} %", count=len(found.controls), share=share)
