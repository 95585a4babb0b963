"""Properties of what a head has learnt: the controls of its rig, which `controls/stored.py` reads and writes, and the
examples by which it was taught, which `styles.py` does.

They are here and not among the settings, as the command needs them, too, which does not register the extension.
"""

import sys

import bpy
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, IntProperty, StringProperty

from ..core.heads.style import MAX_WEIGHT
from .callbacks import use_few
from .registering import register_module


class FacemimeControl(bpy.types.PropertyGroup):
    """A control of a rig that was learnt, by its name, and the region of the face that it moves most.

    `order` is its place among those that help most, from 1, or 0 if they were not ranked, and `error` what those up to
    it leave of the motion.
    """

    region: StringProperty(options={"HIDDEN"})
    order: IntProperty(options={"HIDDEN"})
    error: FloatProperty(options={"HIDDEN"})
    use: BoolProperty(
        name="Use",
        description="Animate this control, in bakes to controls as well as live",
        default=True,
        override={"LIBRARY_OVERRIDABLE"},
    )


class FacemimeRig(bpy.types.PropertyGroup):
    """The controls of a head's rig. `data` is their map in base64, and `shown` the share that they can show.

    `seconds` is how long an evaluation of the rig takes. `ranked` names the motion for which they were ranked; ""
    if they were not.
    """

    controls: CollectionProperty(type=FacemimeControl, override={"LIBRARY_OVERRIDABLE"})
    data: StringProperty(options={"HIDDEN"})
    shown: FloatProperty(options={"HIDDEN"})
    seconds: FloatProperty(options={"HIDDEN"})
    ranked: StringProperty(options={"HIDDEN"})
    few: IntProperty(
        name="Controls",
        description="Use this many controls, those that help most; all others are cleared",
        min=1,
        soft_max=100,
        default=1,
        update=use_few,
    )
    active: IntProperty(
        name="Control", description="Control selected in the list", min=-1, default=-1, options={"HIDDEN"}
    )


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


POINTERS = ((bpy.types.Object, "facemime_rig", FacemimeRig), (bpy.types.Object, "facemime_style", FacemimeStyle))


def ensure_registered() -> None:
    """Register the properties unless the extension has done so."""
    if not hasattr(bpy.types.Object, "facemime_rig"):
        register_module(sys.modules[__name__])
