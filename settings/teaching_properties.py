"""Properties of the examples by which a head was taught; `blender/styles.py` reads and writes them."""

import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..core.heads.style import MAX_WEIGHT


class FacemimeExample(bpy.types.PropertyGroup):
    """An example of how a head should look. `data` is a style with it alone, in base64, and `key` its checksum."""

    data: StringProperty(options={"HIDDEN"})
    key: StringProperty(options={"HIDDEN"})
    performer: StringProperty(name="Performer", description="Performer or take that the example was taught with")
    weight: FloatProperty(
        name="Weight",
        description="Factor of the correction",
        subtype="FACTOR",
        default=1.0,
        min=0.0,
        max=MAX_WEIGHT,
        soft_max=1.0,
    )
    mute: BoolProperty(name="Mute", description="Leave out this example")
