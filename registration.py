"""Registration of all modules with Blender, in one order; unregistration runs in reverse."""

import atexit

import bpy

from .blender.heads import face_display
from .blender.registering import register_module, unregister_module
from .cli import commands
from .operators import (
    attached_parts,
    bake,
    calibrate,
    camera,
    control_points,
    facegen,
    gltf,
    head,
    media,
    own_head,
    pairing,
    parts,
    place_points,
    presets,
    punch_in,
    puppet,
    puppet_video,
    regions,
    take_edits,
    takes,
    viewer,
)
from .sessions import session, show
from .settings import (
    moved_files,
    panel_properties,
    performers,
    preferences,
    properties,
    stream_properties,
    takes_properties,
)
from .ui import calibration as calibration_panel
from .ui import control_points as control_points_panel
from .ui import documentation, menus, placing_overlay, point_overlay, preview, region_overlay, translations
from .ui import expression as expression_panel
from .ui import head as head_panels
from .ui import parts as parts_panel
from .ui import puppet as puppet_panel
from .ui import regions as regions_panel
from .ui import source as source_panel
from .ui import start as start_panel
from .ui import takes as takes_panels
from .ui import viewer as viewer_panel

_MODULES = (
    translations,
    preferences,
    stream_properties,
    properties,
    panel_properties,
    performers,
    takes_properties,
    moved_files,
    face_display,
    attached_parts,
    head,
    facegen,
    own_head,
    place_points,
    parts,
    regions,
    control_points,
    puppet_video,
    puppet,
    viewer,
    pairing,
    camera,
    calibrate,
    presets,
    takes,
    take_edits,
    media,
    punch_in,
    bake,
    gltf,
    documentation,
    menus,
    start_panel,
    head_panels,
    parts_panel,
    source_panel,
    calibration_panel,
    regions_panel,
    control_points_panel,
    expression_panel,
    puppet_panel,
    viewer_panel,
    takes_panels,
    preview,
    region_overlay,
    point_overlay,
    placing_overlay,
    commands,
    session,
    show,
)


def register() -> None:
    """Register every module; if one fails, unregister those before it."""
    done = []
    try:
        for module in _MODULES:
            register_module(module)
            done.append(module)
    except Exception:
        for module in reversed(done):
            unregister_module(module)
        raise
    # As a module of Python, Blender crashes at exit if a class is still registered.
    if getattr(bpy.app, "module", False):
        atexit.register(unregister)


def unregister() -> None:
    """Unregister every module in reverse order."""
    atexit.unregister(unregister)
    for module in reversed(_MODULES):
        unregister_module(module)
