"""Settings that belong to the user and the machine, whatever file is open."""

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, StringProperty

from .storage import EXTENSION


class FacemimePreferences(bpy.types.AddonPreferences):
    """The camera, the preview, and where takes go."""

    bl_idname = EXTENSION

    camera: StringProperty(
        name="Camera",
        description="The camera's number or name, or the address of a stream, such as a telephone's",
        default="0",
    )
    width: IntProperty(name="Width", subtype="PIXEL", default=640, min=160, max=7680)
    height: IntProperty(name="Height", subtype="PIXEL", default=480, min=120, max=4320)
    rate: FloatProperty(name="Rate", description="Frames a second", default=30.0, min=1.0, max=240.0)
    preview: BoolProperty(
        name="Preview", description="Show the picture and the landmarks in the viewport's corner", default=True
    )
    preview_size: IntProperty(name="Size", description="Of the preview", subtype="PIXEL", default=240, min=80, max=640)
    takes_folder: StringProperty(
        name="Takes",
        description="Where takes go that are recorded before the .blend has a name; else they go beside it",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw them in Blender's preferences."""
        layout = self.layout
        layout.use_property_split = True
        draw_camera(layout.column(), self)
        draw_preview(layout, self)
        layout.prop(self, "takes_folder")


def preferences() -> FacemimePreferences:
    """The settings of the user; also where the package runs without being an enabled extension."""
    addons = bpy.context.preferences.addons
    if EXTENSION not in addons:
        addons.new().module = EXTENSION
    return addons[EXTENSION].preferences


def draw_camera(layout: bpy.types.UILayout, chosen: FacemimePreferences) -> None:
    """The camera, with a menu of those that there are, and what it is asked for."""
    row = layout.row(align=True)
    row.prop(chosen, "camera")
    row.menu("FACEMIME_MT_cameras", text="", icon="DOWNARROW_HLT")
    column = layout.column(align=True)
    column.prop(chosen, "width", text="Size")
    column.prop(chosen, "height", text=" ")
    column.prop(chosen, "rate")


def draw_preview(layout: bpy.types.UILayout, chosen: FacemimePreferences) -> None:
    """Whether there is a preview, and how large."""
    row = layout.row(heading="Preview", align=True)
    row.prop(chosen, "preview", text="")
    size = row.row(align=True)
    size.active = chosen.preview
    size.prop(chosen, "preview_size", text="")


CLASSES = (FacemimePreferences,)
