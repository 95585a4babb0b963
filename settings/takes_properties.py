"""Properties of a scene's takes, of their bake and of the key mapping, which is also read as a `KeyMap`."""

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

from ..core.bake.bake_settings import BakeSettings
from ..core.errors import FacemimeError
from ..core.face.names import COEFFICIENTS
from ..core.heads.key_map import KeyMap, KeyRow
from .callbacks import detail_of, refit_last_bake, set_detail
from .rna import with_settings


class FacemimeTake(bpy.types.PropertyGroup):
    """A take in the list: its file, and the user's notes on it.

    `pins` is the JSON of those that the file has, so that an undo can restore them; "" in files of earlier versions.
    """

    path: StringProperty(name="File", description="Path of the take, relative to a saved .blend file")
    packed: PointerProperty(
        name="Packed", description="Text data-block that holds the packed take", type=bpy.types.Text
    )
    length: FloatProperty(name="Length", subtype="TIME_ABSOLUTE", min=0.0)
    star: BoolProperty(name="Favourite", description="Mark this take as a favourite")
    note: StringProperty(name="Note", description="Your note on this take")
    video: StringProperty(
        name="Video", description="The video that the take was tracked from, to edit its landmarks", subtype="FILE_PATH"
    )
    pins: StringProperty(options={"HIDDEN"})


class FacemimeKeyRow(bpy.types.PropertyGroup):
    """A row of the key mapping: shape key = gain * coefficient + offset."""

    source: EnumProperty(
        name="Source",
        description="ARKit coefficient that drives the shape key",
        items=tuple((name, name, "") for name in COEFFICIENTS),
        default="jawOpen",
    )
    key: StringProperty(name="Shape Key", description="Shape key that is driven")
    gain: FloatProperty(name="Gain", description="Factor of the coefficient", default=1.0, soft_min=-2.0, soft_max=2.0)
    offset: FloatProperty(
        name="Offset", description="Value of the shape key at rest", default=0.0, soft_min=-1.0, soft_max=1.0
    )


class FacemimeKeyPose(bpy.types.PropertyGroup):
    """A pose that the key mapping is learnt from: coefficients and values of the shape keys, as JSON."""

    data: StringProperty(options={"HIDDEN"})


@with_settings(BakeSettings)
class FacemimeBake(bpy.types.PropertyGroup):
    """Settings of the bake, and the key mapping."""

    detail: FloatProperty(
        name="Detail",
        description="How closely curves follow the take; at 100 % each frame has a keyframe. The keyframes of the last "
        "bake follow this slider until you change one",
        subtype="PERCENTAGE",
        precision=1,
        min=0.0,
        max=100.0,
        get=detail_of,
        set=set_detail,
        update=refit_last_bake,
    )
    placed: IntProperty(
        name="Frame", description="Frame at which the last take started at the current frame", default=1
    )
    table: StringProperty(name="Mapping", description="Name of the key mapping")
    rows: CollectionProperty(type=FacemimeKeyRow)
    row: IntProperty(name="Row", min=0)
    poses: CollectionProperty(type=FacemimeKeyPose)


class FacemimeTakes(bpy.types.PropertyGroup):
    """Takes of a scene."""

    items: CollectionProperty(type=FacemimeTake)  # type: ignore[assignment]  # hides that of bpy_struct
    index: IntProperty(name="Take", default=0, min=0)
    video: BoolProperty(
        name="Keep Video", description="Save the camera video with the take, as a reference and to track it again"
    )
    countdown: EnumProperty(
        name="Countdown",
        description="Seconds before a recording starts; Esc in the viewport cancels",
        items=(
            ("AUTO", "Automatic", "Three seconds for a camera or a stream, and none for a video or a take", "NONE", 3),
            ("0", "None", "Start at once", "NONE", 0),
            ("3", "3 s", "Three seconds", "NONE", 1),
            ("5", "5 s", "Five seconds", "NONE", 2),
        ),
        default="AUTO",
    )
    bake: PointerProperty(type=FacemimeBake)


def read_table(bake: FacemimeBake) -> KeyMap:
    """Return the key mapping; raises FacemimeError if a row has no key."""
    for number, row in enumerate(bake.rows, start=1):
        if not row.key:
            raise FacemimeError(
                "Row {number} of the key mapping has no shape key. Choose one, or remove the row.", number=number
            )
    return table_so_far(bake)


def table_so_far(bake: FacemimeBake) -> KeyMap:
    """Return the key mapping without the rows that have no key yet."""
    rows = (KeyRow(row.source, row.key, row.gain, row.offset) for row in bake.rows if row.key)
    return KeyMap(bake.table or "Mapping", tuple(rows))


def write_table(bake: FacemimeBake, table: KeyMap) -> None:
    """Replace the rows and the name of the key mapping with those of `table`."""
    bake.table = table.name
    bake.rows.clear()
    for row in table.rows:
        line = bake.rows.add()
        line.source, line.key, line.gain, line.offset = row.source, row.key, row.gain, row.offset
    bake.row = 0


POINTERS = ((bpy.types.Scene, "facemime_takes", FacemimeTakes),)
