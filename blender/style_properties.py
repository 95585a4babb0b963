"""Properties of the examples by which a head was taught; `styles.py` reads and writes them.

They are here and not among the settings, as the command needs them, too, which does not register the extension.
"""

import sys

import bpy
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, IntProperty, StringProperty

from ..core.heads.style import MAX_WEIGHT
from .registering import register_module


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


class FacemimeStyle(bpy.types.PropertyGroup):
    """The examples of a head."""

    examples: CollectionProperty(type=FacemimeExample)
    example: IntProperty(name="Example", min=0)


POINTERS = ((bpy.types.Object, "facemime_style", FacemimeStyle),)


def ensure_registered() -> None:
    """Register the properties unless the extension has done so."""
    if not hasattr(bpy.types.Object, "facemime_style"):
        register_module(sys.modules[__name__])
