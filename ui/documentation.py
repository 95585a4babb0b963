"""Links to the documentation: in the headers of panels, and for Online Manual (F1) on Facemime's buttons.

The pages are part of the extension, so that they open without a network; `tools/manual.py` renders them from docs/.
"""

from __future__ import annotations

from pathlib import Path

import bpy

_MANUAL_FOLDER = Path(__file__).resolve().parents[1] / "manual"
_WEBCAM = "tutorials/webcam.html"
_OWN_HEAD = "tutorials/own_head.html"
_TAKES = "guides/takes.html"
PANELS = {
    "FACEMIME_PT_start": f"{_WEBCAM}#add-a-head",
    "FACEMIME_PT_head": _OWN_HEAD,
    "FACEMIME_PT_own_head": _OWN_HEAD,
    "FACEMIME_PT_parts": f"{_OWN_HEAD}#the-parts-of-a-character",
    "FACEMIME_PT_controls": f"{_OWN_HEAD}#the-controls-of-a-rig",
    "FACEMIME_PT_source": f"{_WEBCAM}#choose-your-camera",
    "FACEMIME_PT_calibration": f"{_WEBCAM}#calibrate",
    "FACEMIME_PT_regions": f"{_OWN_HEAD}#check-the-regions",
    "FACEMIME_PT_control_points": "accuracy/deformation.html#control-points-from-a-take",
    "FACEMIME_PT_expression": f"{_WEBCAM}#adjust-the-expression",
    "FACEMIME_PT_fit": "accuracy/deformation.html#the-paper-s-method",
    "FACEMIME_PT_puppet": f"{_WEBCAM}#start-the-puppet",
    "FACEMIME_PT_pose": f"{_WEBCAM}#start-the-puppet",
    "FACEMIME_PT_send": "guides/streams.html#in-blender",
    "FACEMIME_PT_incoming": "guides/streams.html#in-blender",
    "FACEMIME_PT_viewer": "guides/viewer.html#in-blender",
    "FACEMIME_PT_bake": f"{_TAKES}#baking",
    "FACEMIME_PT_takes": f"{_TAKES}#in-blender",
    "FACEMIME_PT_take_bake": f"{_TAKES}#baking",
    "FACEMIME_PT_strengths": f"{_TAKES}#baking",
    "FACEMIME_PT_key_map": f"{_TAKES}#key-mappings",
    "FACEMIME_PT_teaching": f"{_TAKES}#teaching-a-head",
}
"""Page of each panel with a header."""
_MANUAL = (
    ("bpy.ops.facemime.bake_take*", f"{_TAKES}#baking"),
    ("bpy.ops.facemime.mend_take*", f"{_TAKES}#mending"),
    ("bpy.ops.facemime.edit_landmarks*", f"{_TAKES}#pins"),
    ("bpy.ops.facemime.next_doubtful*", f"{_TAKES}#pins"),
    ("bpy.ops.facemime.learn_from_pins*", f"{_TAKES}#pins"),
    ("bpy.ops.facemime.take_from_animation*", f"{_TAKES}#takes-from-animation"),
    ("bpy.ops.facemime.teach_frame*", f"{_TAKES}#teaching-a-head"),
    ("bpy.ops.facemime.suggest_frames*", f"{_TAKES}#teaching-a-head"),
    ("bpy.ops.facemime.remove_example*", f"{_TAKES}#teaching-a-head"),
    ("bpy.ops.facemime.*_style*", f"{_TAKES}#teaching-a-head"),
    ("bpy.types.facemimeexample*", f"{_TAKES}#teaching-a-head"),
    ("bpy.ops.facemime.*take*", f"{_TAKES}#in-blender"),
    ("bpy.ops.facemime.add_sound*", f"{_TAKES}#in-blender"),
    ("bpy.ops.facemime.add_reference*", f"{_TAKES}#in-blender"),
    ("bpy.ops.facemime.*pairing*", "guides/streams.html#across-networks"),
    ("bpy.ops.facemime.*key*", f"{_TAKES}#key-mappings"),
    ("bpy.ops.facemime.*calibrate*", f"{_WEBCAM}#calibrate"),
    ("bpy.ops.facemime.*performer*", f"{_WEBCAM}#calibrate"),
    ("bpy.ops.facemime.*preset*", f"{_WEBCAM}#adjust-the-expression"),
    ("bpy.ops.facemime.*viewer*", "guides/viewer.html#in-blender"),
    ("bpy.ops.facemime.*puppet*", f"{_WEBCAM}#start-the-puppet"),
    ("bpy.ops.facemime.*camera*", f"{_WEBCAM}#choose-your-camera"),
    ("bpy.ops.facemime.add_head*", f"{_WEBCAM}#add-a-head"),
    ("bpy.ops.facemime.*control_point*", "accuracy/deformation.html#control-points-from-a-take"),
    ("bpy.ops.facemime.*_controls*", f"{_OWN_HEAD}#the-controls-of-a-rig"),
    ("bpy.ops.facemime.add_face_rig*", f"{_OWN_HEAD}#a-rig-for-a-head-without-one"),
    ("bpy.ops.facemime.export_control_sheet*", f"{_OWN_HEAD}#the-controls-of-a-rig"),
    ("bpy.types.facemimerig*", f"{_OWN_HEAD}#the-controls-of-a-rig"),
    ("bpy.types.facemimecontrol*", f"{_OWN_HEAD}#the-controls-of-a-rig"),
    ("bpy.ops.facemime.*part*", f"{_OWN_HEAD}#the-parts-of-a-character"),
    ("bpy.ops.facemime.*bone*", f"{_OWN_HEAD}#the-parts-of-a-character"),
    ("bpy.ops.facemime.*region*", f"{_OWN_HEAD}#check-the-regions"),
    ("bpy.ops.facemime.open_*", f"{_OWN_HEAD}#open-the-lips-and-the-eyes"),
    ("bpy.ops.facemime.*landmark*", _OWN_HEAD),
    ("bpy.ops.facemime.*", "index.html"),
    ("bpy.types.facemimesource.*", f"{_WEBCAM}#choose-your-camera"),
    ("bpy.types.facemimetake*", f"{_TAKES}#in-blender"),
    ("bpy.types.facemimebake.*", f"{_TAKES}#baking"),
    ("bpy.types.facemimekey*", f"{_TAKES}#key-mappings"),
    ("bpy.types.facemimesteps.*", f"{_OWN_HEAD}#check-the-regions"),
    ("bpy.types.facemimesettings.*", f"{_WEBCAM}#adjust-the-expression"),
    ("bpy.types.facemime*", "index.html"),
)
"""Pages of operators and properties, in lower case as Blender looks them up; the first match is used."""


def address(page: str) -> str:
    """Return the address of a page; "" stands for the folder of all pages."""
    return f"{_MANUAL_FOLDER.as_uri()}/{page}"


def draw_link(layout: bpy.types.UILayout, panel: str) -> None:
    """Draw an icon that opens the documentation of a panel, given the name of its class."""
    layout.operator("wm.url_open", text="", icon="QUESTION", emboss=False).url = address(PANELS[panel])


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the pages of operators and properties, as Blender's Online Manual expects them."""
    return address(""), _MANUAL


def register() -> None:
    """Register the pages with Blender's Online Manual."""
    bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Unregister the pages."""
    bpy.utils.unregister_manual_map(manual_map)
