"""Entries in Blender's menus."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import bpy

from ..blender.messages import CONTEXT
from ..blender.stubs import EventType, Icon, MenuMixin


def _add_head(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.add_head", icon="MONKEY")


def _import(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.operator("facemime.import_facegen")
    menu.layout.operator("facemime.import_take", text="Face Take", text_ctxt=CONTEXT)


_ENTRIES: tuple[tuple[tuple[str, Icon], ...], ...] = (
    (
        ("facemime.puppet", "PLAY"),
        ("facemime.stop_puppet", "SNAP_FACE"),
        ("facemime.record_take", "REC"),
        ("facemime.next_face", "COMMUNITY"),
    ),
    (
        ("facemime.puppet_video", "FILE_MOVIE"),
        ("facemime.take_from_animation", "ANIM"),
        ("facemime.import_take", "IMPORT"),
        ("facemime.export_take", "EXPORT"),
        ("facemime.show_take", "HIDE_OFF"),
        ("facemime.trim_take", "ARROW_LEFTRIGHT"),
        ("facemime.mend_take", "MODIFIER"),
        ("facemime.edit_landmarks", "EMPTY_AXIS"),
        ("facemime.next_doubtful_frame", "VIEWZOOM"),
        ("facemime.bake_take", "ACTION"),
        ("facemime.export_gltf", "EXPORT"),
    ),
    (
        ("facemime.bind_landmarks", "VIEWZOOM"),
        ("facemime.bind_keys", "SHAPEKEY_DATA"),
        ("facemime.mark_face", "PIVOT_CURSOR"),
        ("facemime.adjust_landmarks", "CON_TRACKTO"),
        ("facemime.check_head", "CHECKMARK"),
        ("facemime.propose_regions", "GROUP_VERTEX"),
        ("facemime.open_lips", "SCULPTMODE_HLT"),
        ("facemime.open_eyes", "HIDE_OFF"),
        ("facemime.make_expression_keys", "SHAPEKEY_DATA"),
        ("facemime.add_face_rig", "ARMATURE_DATA"),
        ("facemime.learn_controls", "POSE_HLT"),
        ("facemime.export_control_sheet", "EXPORT"),
    ),
)
"""Operators of the menu Facemime with their icons, in groups: live, takes, heads."""
_SUBMENUS: tuple[tuple[tuple[str, Icon], ...], ...] = (
    (
        ("FACEMIME_MT_calibrate", "USER"),
        ("FACEMIME_MT_presets", "PRESET"),
        ("FACEMIME_MT_viewer", "WORLD"),
    ),
    (
        ("FACEMIME_MT_takes", "COLLAPSEMENU"),
        ("FACEMIME_MT_key_mapping", "SHAPEKEY_DATA"),
        ("FACEMIME_MT_teaching", "BOOKMARKS"),
    ),
    (
        ("FACEMIME_MT_landmarks", "CON_TRACKTO"),
        ("FACEMIME_MT_regions", "GROUP_VERTEX"),
        ("FACEMIME_MT_select_from_take", "CURVE_DATA"),
        ("FACEMIME_MT_control_points", "CURVE_DATA"),
        ("FACEMIME_MT_rank_controls", "CURVE_DATA"),
    ),
)
"""Submenus below the operators of each group, with their icons."""
_KEYS: tuple[tuple[str, EventType], ...] = (
    ("facemime.puppet", "P"),
    ("facemime.stop_puppet", "P"),
    ("facemime.record_take", "R"),
)
"""Operators and their keys, with Shift and Alt: the first one that can run is run."""


class VIEW3D_MT_facemime(bpy.types.Menu):
    """Everything that Facemime does, so that Blender's search finds it"""

    bl_label = "Facemime"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators."""
        layout = self.layout
        layout.operator_context = "INVOKE_REGION_WIN"
        layout.menu("FACEMIME_MT_add", icon="ADD")
        for operators, submenus in zip(_ENTRIES, _SUBMENUS, strict=True):
            layout.separator()
            for operator, icon in operators:
                layout.operator(operator, icon=icon)
            for menu, icon in submenus:
                layout.menu(menu, icon=icon)


class _Entry(NamedTuple):
    """An operator with its icon and, if it is not drawn with its own label and defaults, a label and properties."""

    operator: str
    icon: Icon
    text: str = ""
    properties: Mapping[str, str] = MappingProxyType({})


class _ListsEntries(MenuMixin):
    """Mixin: a menu of operators."""

    entries: tuple[_Entry, ...]

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators."""
        self.layout.operator_context = "INVOKE_REGION_WIN"
        for operator, icon, text, properties in self.entries:
            if text:
                button = self.layout.operator(operator, icon=icon, text=text, text_ctxt=CONTEXT)
            else:
                button = self.layout.operator(operator, icon=icon)
            for name, value in properties.items():
                setattr(button, name, value)


class FACEMIME_MT_calibrate(_ListsEntries, bpy.types.Menu):
    """Calibrate to the performer's face, and choose who performs"""

    bl_label = "Calibrate"
    entries = (
        _Entry("facemime.calibrate", "USER", text="Neutral Face", properties={"pose": "NEUTRAL"}),
        _Entry("facemime.calibrate", "HIDE_OFF", text="Eyes and Mouth", properties={"pose": "RANGE"}),
        _Entry("facemime.reset_calibration", "LOOP_BACK"),
        _Entry("facemime.add_performer", "ADD"),
        _Entry("facemime.remove_performer", "REMOVE"),
        _Entry("facemime.clear_calibrations", "TRASH"),
    )


class FACEMIME_MT_viewer(_ListsEntries, bpy.types.Menu):
    """Show the running puppet in a browser"""

    bl_label = "Viewer"
    entries = (_Entry("facemime.open_viewer", "WORLD"), _Entry("facemime.copy_viewer_address", "COPYDOWN"))


class FACEMIME_MT_key_mapping(_ListsEntries, bpy.types.Menu):
    """Map what is tracked to the shape keys that a head has"""

    bl_label = "Key Mapping"
    entries = (
        _Entry("facemime.detect_key_map", "VIEWZOOM"),
        _Entry("facemime.add_key_pose", "ADD"),
        _Entry("facemime.learn_key_map", "MODIFIER"),
        _Entry("facemime.import_key_map", "IMPORT"),
        _Entry("facemime.export_key_map", "EXPORT"),
        _Entry("facemime.mute_others", "MUTE_IPO_ON"),
        _Entry("facemime.add_corrections", "NLA_PUSHDOWN"),
        _Entry("facemime.remove_corrections", "X"),
    )


class FACEMIME_MT_teaching(_ListsEntries, bpy.types.Menu):
    """Teach the selected head by examples of how it should look"""

    bl_label = "Teaching"
    entries = (
        _Entry("facemime.suggest_frames", "VIEWZOOM"),
        _Entry("facemime.teach_frame", "ADD"),
        _Entry("facemime.remove_example", "REMOVE"),
        _Entry("facemime.load_style", "IMPORT"),
        _Entry("facemime.save_style", "EXPORT"),
    )


class FACEMIME_MT_landmarks(_ListsEntries, bpy.types.Menu):
    """Change the landmarks and the parts of a character"""

    bl_label = "Landmarks and Parts"
    entries = (
        _Entry("facemime.pick_landmark", "EYEDROPPER"),
        _Entry("facemime.set_landmark", "PIVOT_CURSOR"),
        _Entry("facemime.clear_marks", "X"),
        _Entry("facemime.find_parts", "VIEWZOOM"),
    )


class FACEMIME_MT_regions(_ListsEntries, bpy.types.Menu):
    """Paint and edit the regions of the face"""

    bl_label = "Regions"
    entries = (
        _Entry("facemime.paint_region", "BRUSH_DATA", text="Paint Upper", properties={"region": "UPPER"}),
        _Entry("facemime.paint_region", "BRUSH_DATA", text="Paint Middle", properties={"region": "MIDDLE"}),
        _Entry("facemime.paint_region", "BRUSH_DATA", text="Paint Lower", properties={"region": "LOWER"}),
        _Entry("facemime.leave_painting", "LOOP_BACK"),
        _Entry("facemime.mirror_regions", "MOD_MIRROR", text="Mirror Left to Right", properties={"source": "left"}),
        _Entry("facemime.mirror_regions", "MOD_MIRROR", text="Mirror Right to Left", properties={"source": "right"}),
        _Entry("facemime.smooth_regions", "MOD_SMOOTH"),
    )


class FACEMIME_MT_control_points(_ListsEntries, bpy.types.Menu):
    """Change which landmarks are control points"""

    bl_label = "Control Points"
    entries = (
        _Entry("facemime.select_live_points", "RESTRICT_VIEW_OFF"),
        _Entry("facemime.add_control_point", "ADD"),
        _Entry("facemime.drop_control_point", "REMOVE"),
        _Entry("facemime.use_all_landmarks", "LOOP_BACK"),
    )


def _facemime(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.menu("VIEW3D_MT_facemime")


class _Keys:
    """The shortcuts that were added."""

    added: ClassVar[list[tuple[bpy.types.KeyMap, bpy.types.KeyMapItem]]] = []


def register() -> None:
    """Add the menu Facemime, the entries of Add > Mesh and File > Import, and shortcuts."""
    bpy.types.VIEW3D_MT_editor_menus.append(_facemime)
    bpy.types.VIEW3D_MT_mesh_add.append(_add_head)
    bpy.types.TOPBAR_MT_file_import.append(_import)
    if (configuration := bpy.context.window_manager.keyconfigs.addon) is not None:  # there is none without a window
        keymap = configuration.keymaps.new(name="3D View", space_type="VIEW_3D")
        for operator, key in _KEYS:
            _Keys.added.append((keymap, keymap.keymap_items.new(operator, key, "PRESS", shift=True, alt=True)))
        # The puppet itself handles Esc in the window in which it was started.
        _Keys.added.append((keymap, keymap.keymap_items.new("facemime.stop_puppet", "ESC", "PRESS")))


def unregister() -> None:
    """Remove the entries and shortcuts."""
    for keymap, item in _Keys.added:
        keymap.keymap_items.remove(item)
    _Keys.added.clear()
    bpy.types.VIEW3D_MT_editor_menus.remove(_facemime)
    bpy.types.TOPBAR_MT_file_import.remove(_import)
    bpy.types.VIEW3D_MT_mesh_add.remove(_add_head)
