"""What Blender is told of: one ordered tuple of modules, registered forwards and unregistered backwards."""

from . import commands, properties, session
from .operators import calibrate, control_points, facegen, head, own_head, puppet, puppet_video
from .ui import calibration as calibration_panel
from .ui import control_points as control_points_panel
from .ui import expression as expression_panel
from .ui import head as head_panels
from .ui import menus, preview
from .ui import puppet as puppet_panel
from .ui import source as source_panel

_MODULES = (
    properties,
    head,
    facegen,
    own_head,
    control_points,
    puppet_video,
    puppet,
    calibrate,
    menus,
    head_panels,
    source_panel,
    calibration_panel,
    control_points_panel,
    expression_panel,
    puppet_panel,
    preview,
    commands,
    session,
)


def register() -> None:
    """Register every module; what was registered is taken back where one fails."""
    done = []
    try:
        for module in _MODULES:
            module.register()
            done.append(module)
    except Exception:
        for module in reversed(done):
            module.unregister()
        raise


def unregister() -> None:
    """Unregister every module, the last first."""
    for module in reversed(_MODULES):
        module.unregister()
