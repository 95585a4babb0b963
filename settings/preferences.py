"""Preferences: settings of the user and the computer, independent of the open file."""

import bpy
from bpy.props import BoolProperty, FloatProperty, FloatVectorProperty, IntProperty, StringProperty

from ..blender.messages import CONTEXT

EXTENSION = __package__.rpartition(".")[0]
"""Name by which Blender knows the extension."""


class FacemimePreferences(bpy.types.AddonPreferences):
    """Camera, preview, pairing, and the folder for takes."""

    bl_idname = EXTENSION

    camera: StringProperty(
        name="Camera",
        description="Number or name of the camera, or the address of a video stream, such as a phone's",
        default="0",
    )
    width: IntProperty(
        name="Width", description="Requested width of the image", subtype="PIXEL", default=640, min=160, max=7680
    )
    height: IntProperty(
        name="Height", description="Requested height of the image", subtype="PIXEL", default=480, min=120, max=4320
    )
    rate: FloatProperty(name="Rate", description="Requested frames per second", default=30.0, min=1.0, max=240.0)
    preview: BoolProperty(
        name="Preview",
        description="Show the image and the landmarks in the viewport; drag it to move it, or its upper right corner "
        "to resize it",
        default=True,
    )
    preview_size: IntProperty(
        name="Size", description="Width of the preview", subtype="PIXEL", default=240, min=80, max=640
    )
    preview_place: FloatVectorProperty(
        name="Position",
        description="Position of the preview from the lower left corner of the viewport; drag the preview to move it",
        size=2,
        default=(0.0, 0.0),
    )
    sounds: BoolProperty(
        name="Sounds", description="Beep when a recording starts and when a calibration ends", default=True
    )
    pairing: StringProperty(
        name="Pairing",
        description=(
            "Line from Send > Across Networks on the other computer, to receive its stream over TLS; it is secret, and "
            "not stored in the .blend file"
        ),
        subtype="PASSWORD",
    )
    takes_folder: StringProperty(
        name="Takes",
        description="Folder for takes recorded before the .blend file is saved, by default Facemime in your documents; "
        "they move beside the .blend file when it is first saved",
        subtype="DIR_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preferences."""
        layout = self.layout
        layout.use_property_split = True
        draw_camera(layout.column(), self)
        draw_preview(layout, self)
        layout.prop(self, "sounds")
        layout.prop(self, "pairing")
        layout.prop(self, "takes_folder")


def preferences() -> FacemimePreferences:
    """Return the preferences, even if the package is not running as an enabled extension."""
    addons = bpy.context.preferences.addons
    if EXTENSION not in addons:
        addons.new().module = EXTENSION
    found = addons[EXTENSION].preferences
    assert isinstance(found, FacemimePreferences)
    return found


def draw_camera(layout: bpy.types.UILayout, chosen: FacemimePreferences) -> None:
    """Draw the camera with a menu of those available, its resolution and frame rate."""
    row = layout.row(align=True)
    row.prop(chosen, "camera")
    row.menu("FACEMIME_MT_cameras", text="", icon="DOWNARROW_HLT")
    column = layout.column(align=True)
    column.prop(chosen, "width", text="Size", text_ctxt=CONTEXT)
    column.prop(chosen, "height", text=" ")
    column.prop(chosen, "rate")


def draw_preview(layout: bpy.types.UILayout, chosen: FacemimePreferences) -> None:
    """Draw the preview switch and size."""
    row = layout.row(heading="Preview", heading_ctxt=CONTEXT, align=True)
    row.prop(chosen, "preview", text="")
    size = row.row(align=True)
    size.active = chosen.preview
    size.prop(chosen, "preview_size", text="")
