"""Properties of the controls that were learnt; `blender/controls/stored.py` reads and writes them."""

import bpy
from bpy.props import BoolProperty, StringProperty


class FacemimeControl(bpy.types.PropertyGroup):
    """A control of a rig that was learnt, by its name, and the region of the face that it moves most."""

    region: StringProperty(options={"HIDDEN"})
    use: BoolProperty(name="Use", description="Animate this control when a take is baked to controls", default=True)
