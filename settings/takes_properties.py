"""The takes of a scene, what a bake is made to, and the table of keys. Plain values come from `takes_store.py`."""

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ..core.bake.arkit import COEFFICIENTS
from ..core.bake.settings import BakeSettings
from .rna import with_settings


class FacemimeTake(bpy.types.PropertyGroup):
    """A take, by `name`: where it is, and what the user says of it."""

    path: StringProperty(name="File", description="Relative to the .blend where that has a name")
    packed: PointerProperty(name="Packed", description="The take within the .blend, as text", type=bpy.types.Text)
    length: FloatProperty(name="Length", subtype="TIME_ABSOLUTE", min=0.0)
    star: BoolProperty(name="Star", description="One of the good ones")
    note: StringProperty(name="Note", description="What you think of it")


class FacemimeKeyRow(bpy.types.PropertyGroup):
    """A row of the table: a key gets a coefficient, times a gain, plus an offset."""

    source: EnumProperty(
        name="Source",
        description="One of ARKit's 52 coefficients",
        items=tuple((name, name, "") for name in COEFFICIENTS),
        default="jawOpen",
    )
    key: StringProperty(name="Key", description="The shape key that it moves")
    gain: FloatProperty(name="Gain", default=1.0, soft_min=-2.0, soft_max=2.0)
    offset: FloatProperty(name="Offset", default=0.0, soft_min=-1.0, soft_max=1.0)


class FacemimeKeyPose(bpy.types.PropertyGroup):
    """A frame of a take for which the user posed the keys: its coefficients and their values, as JSON."""

    data: StringProperty(options={"HIDDEN"})


@with_settings(BakeSettings)
class FacemimeBake(bpy.types.PropertyGroup):
    """What a take is baked to."""

    table: StringProperty(name="Table", description="Name of the table of keys")
    rows: CollectionProperty(type=FacemimeKeyRow)
    row: IntProperty(name="Row", min=0)
    poses: CollectionProperty(type=FacemimeKeyPose)


class FacemimeTakes(bpy.types.PropertyGroup):
    """The takes of a scene."""

    items: CollectionProperty(type=FacemimeTake)
    index: IntProperty(name="Take", default=0, min=0)
    video: BoolProperty(
        name="Keep Video", description="Write what is seen beside the take: to look at, and to track again"
    )
    bake: PointerProperty(type=FacemimeBake)


CLASSES = (FacemimeTake, FacemimeKeyRow, FacemimeKeyPose, FacemimeBake, FacemimeTakes)
POINTERS = ((bpy.types.Scene, "facemime_takes", FacemimeTakes),)
