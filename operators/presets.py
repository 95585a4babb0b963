"""Operators that save, load, remove and share presets."""

import bpy
from bpy.props import BoolProperty, StringProperty

from ..blender.stubs import OperatorResult
from ..core.puppet.presets import SUFFIX, built_in_path
from ..settings import user_presets as presets
from .shared import AsksForFile, AsksForFileToWrite, ReportsErrors


class FACEMIME_OT_save_preset(ReportsErrors, bpy.types.Operator):
    """Save strength, smoothing and limits as a preset"""

    bl_idname = "facemime.save_preset"
    bl_label = "Save Preset"
    bl_options = {"REGISTER"}

    name: StringProperty(name="Name", default="My Preset")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the name."""
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context: bpy.types.Context) -> None:
        """Save the preset, replacing one of the same name."""
        presets.save(context.scene.facemime, presets.path_of(self.name))


class FACEMIME_OT_load_preset(ReportsErrors, bpy.types.Operator):
    """Set strength, smoothing and limits from this preset"""

    bl_idname = "facemime.load_preset"
    bl_label = "Load Preset"

    name: StringProperty(name="Name")
    built_in: BoolProperty(name="Built-In", options={"SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> None:
        """Load the preset."""
        path = built_in_path(self.name) if self.built_in else presets.path_of(self.name)
        presets.load(context.scene.facemime, path)


class FACEMIME_OT_remove_preset(ReportsErrors, bpy.types.Operator):
    """Remove this preset"""

    bl_idname = "facemime.remove_preset"
    bl_label = "Remove Preset"
    bl_options = {"REGISTER"}

    name: StringProperty(name="Name")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask first, as removing a file cannot be undone."""
        return context.window_manager.invoke_confirm(self, event)

    def work(self, context: bpy.types.Context) -> None:
        """Remove the file."""
        presets.remove(self.name)


class FACEMIME_OT_import_preset(AsksForFile, bpy.types.Operator):
    """Set strength, smoothing and limits from a file, and add it to your presets"""

    bl_idname = "facemime.import_preset"
    bl_label = "Import Preset"

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Load the file, and save it as a preset."""
        path = self.path
        kept = presets.path_of(path.stem)
        presets.load(context.scene.facemime, path)
        presets.save(context.scene.facemime, kept)


class FACEMIME_OT_export_preset(AsksForFileToWrite, bpy.types.Operator):
    """Export strength, smoothing and limits to a file"""

    bl_idname = "facemime.export_preset"
    bl_label = "Export Preset"

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Write the file."""
        presets.save(context.scene.facemime, self.path_ending(SUFFIX))
