"""Registration of all modules with Blender, in one order; unregistration runs in reverse."""

import atexit

import bpy

from .blender import head_properties, messages
from .blender.heads import face_display
from .blender.registering import register_module, unregister_module
from .cli import entry
from .core.errors import Message
from .operators import (
    attached_parts,
    bake,
    calibrate,
    control_points,
    controls,
    head,
    landmark_edit,
    own_head,
    parts,
    place_points,
    presets,
    puppet,
    puppet_video,
    take_edits,
    takes,
    teaching,
    viewer,
)
from .sessions import landmark_edit as landmark_session
from .sessions import session, show
from .settings import (
    panel_properties,
    performers,
    preferences,
    properties,
    storage,
    takes_properties,
)
from .ui import control_arrows, documentation, landmark_editor, menus, overlays, status
from .ui import control_points as control_points_panel
from .ui import controls as controls_panel
from .ui import head as head_panels
from .ui import puppet as puppet_panel
from .ui import source as source_panel
from .ui import start as start_panel
from .ui import takes as takes_panels
from .ui import teaching as teaching_panel

_MODULES = (
    messages,
    preferences,
    head_properties,
    properties,
    panel_properties,
    performers,
    takes_properties,
    storage,
    face_display,
    attached_parts,
    head,
    own_head,
    place_points,
    parts,
    controls,
    control_points,
    puppet_video,
    puppet,
    viewer,
    calibrate,
    presets,
    takes,
    take_edits,
    landmark_edit,
    bake,
    teaching,
    documentation,
    menus,
    start_panel,
    head_panels,
    controls_panel,
    source_panel,
    control_points_panel,
    puppet_panel,
    takes_panels,
    teaching_panel,
    status,
    overlays,
    control_arrows,
    landmark_editor,
    entry,
    session,
    show,
    landmark_session,
)


def register() -> None:
    """Register every module; if one fails, unregister those before it.

    Raises RuntimeError if a copy from another repository is enabled: Blender would replace its classes by these, one by
    one, and could then disable neither copy.
    """
    if (other := _other_copy()) is not None:
        raise RuntimeError(
            Message(
                "Another copy of Facemime is enabled: {package}. Disable that one under Preferences > Add-ons, and "
                "enable this one again.",
                package=other,
            )
        )
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


def _other_copy() -> str | None:
    """Return the package of another copy of Facemime whose classes are registered, or None."""
    operator = getattr(bpy.types, puppet.FACEMIME_OT_puppet.__name__, None)
    module = str(getattr(operator, "__module__", ""))
    package = module.removesuffix(puppet.__name__.removeprefix(__package__))
    return package if package not in ("", module, __package__) else None


def unregister() -> None:
    """Unregister every module in reverse order."""
    atexit.unregister(unregister)
    for module in reversed(_MODULES):
        unregister_module(module)
