"""Properties of the controls of a rig that were learnt; `controls/stored.py` reads and writes them.

They are here and not among the settings, as the command needs them, too, which does not register the extension.
"""

import sys

import bpy
from bpy.props import BoolProperty, CollectionProperty, FloatProperty, StringProperty

from .registering import register_module


class FacemimeControl(bpy.types.PropertyGroup):
    """A control of a rig that was learnt, by its name, and the region of the face that it moves most."""

    region: StringProperty(options={"HIDDEN"})
    use: BoolProperty(name="Use", description="Animate this control when a take is baked to controls", default=True)


class FacemimeRig(bpy.types.PropertyGroup):
    """The controls of a head's rig. `data` is their map in base64, and `shown` the share that they can show."""

    controls: CollectionProperty(type=FacemimeControl)
    data: StringProperty(options={"HIDDEN"})
    shown: FloatProperty(options={"HIDDEN"})


POINTERS = ((bpy.types.Object, "facemime_rig", FacemimeRig),)


def ensure_registered() -> None:
    """Register the properties unless the extension has done so."""
    if not hasattr(bpy.types.Object, "facemime_rig"):
        register_module(sys.modules[__name__])
