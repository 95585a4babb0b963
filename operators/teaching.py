"""Operators that teach a head by examples, and share them as a file."""

from typing import ClassVar

import bpy
from bpy.props import IntProperty, StringProperty

from ..blender.meshes import can_be_driven
from ..blender.rigs import read_rig
from ..blender.styles import add_style, read_style, remove_example, style_group
from ..core.heads.style import SUFFIX, load_style, save_style
from ..sessions.show import TakeShow
from ..sessions.teaching import shown_head, suggested_frames, teach
from .shared import (
    AsksForFile,
    AsksForFileToWrite,
    Need,
    OnHead,
    ReportsErrors,
    report,
    require,
    require_left_edit_mode,
    required_subject,
    subject,
)


def require_shown_take(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require that heads show a take, as `require` does."""
    return require(operator, TakeShow.running() is not None, "Show a take first, with Preview on Head")


def require_example(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Require a head with examples, as `require` does."""
    obj = subject(context)
    known = obj is not None and can_be_driven(obj) and len(style_group(obj).examples) > 0
    return require(operator, known, "Teach the head a frame first, or load a style")


class OnShownTake(ReportsErrors):
    """Mixin: requires a take that heads show, outside Edit Mode."""

    needs: ClassVar[tuple[Need, ...]] = (require_shown_take, require_left_edit_mode)


class FACEMIME_OT_teach_frame(OnShownTake, bpy.types.Operator):
    """Keep how the head looks now as an example of this expression, by which it is corrected from now on"""

    bl_idname = "facemime.teach_frame"
    bl_label = "Teach This Frame"

    def work(self, context: bpy.types.Context) -> None:
        if (show := TakeShow.running()) is None:
            return
        number = shown_head(show, subject(context))
        if left := teach(show, context.scene, number):
            names = ", ".join(left)
            report(self, "Drivers move {names}. Return what drives them to rest yourself.", "WARNING", names=names)
        head = show.heads[number].obj
        report(self, "{name} has {count} examples", name=head.name, count=len(style_group(head).examples))


class FACEMIME_OT_suggest_frames(OnShownTake, bpy.types.Operator):
    """Go to the next of the few frames of the take in which an example would help the head most"""

    bl_idname = "facemime.suggest_frames"
    bl_label = "Suggest Frames"

    count: IntProperty(name="Frames", description="Number of frames to suggest", default=5, min=1, max=50)

    def work(self, context: bpy.types.Context) -> None:
        """Go to the first suggested frame after the current one, or to the first of all."""
        if (show := TakeShow.running()) is None:
            return
        frames = suggested_frames(show, context.scene, shown_head(show, subject(context)), self.count)
        if not frames:
            report(self, "The examples cover all expressions of this take")
            return
        current = context.scene.frame_current
        frame = next((frame for frame in frames if frame > current), frames[0])
        context.scene.frame_set(frame)
        place, count = frames.index(frame) + 1, len(frames)
        report(self, "Frame {frame}: suggestion {place} of {count}", frame=frame, place=place, count=count)


class FACEMIME_OT_remove_example(ReportsErrors, bpy.types.Operator):
    """Remove the selected example"""

    bl_idname = "facemime.remove_example"
    bl_label = "Remove Example"
    needs = (require_example,)

    def work(self, context: bpy.types.Context) -> None:
        head = required_subject(context)
        if (style := style_group(head)).example < len(style.examples):
            remove_example(head, style.example)


class FACEMIME_OT_save_style(AsksForFileToWrite, bpy.types.Operator):
    """Save the examples of the head as a file, for other copies of it"""

    bl_idname = "facemime.save_style"
    bl_label = "Save Style"
    needs = (require_example,)

    filter_glob: StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        save_style(read_style(required_subject(context)), self.path_ending(SUFFIX))


class FACEMIME_OT_load_style(AsksForFile, OnHead, bpy.types.Operator):
    """Add the examples of a file to those of the head"""

    bl_idname = "facemime.load_style"
    bl_label = "Load Style"
    needs_landmarks = False

    filter_glob: StringProperty(default=f"*{SUFFIX}", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        head, style = required_subject(context), load_style(self.path)
        add_style(head, style, len(read_rig(head).all_vertices))
        report(self, "{count} examples added to {name}", count=len(style.examples), name=head.name)
