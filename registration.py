"""What Blender is told of: one ordered tuple of modules, registered forwards and unregistered backwards."""

from . import commands, properties, session
from .operators import control_points, facegen, head, own_head, puppet_video
from .ui import menus, panel
from .ui import own_head as own_head_panels

_MODULES = (
    properties,
    head,
    facegen,
    own_head,
    control_points,
    puppet_video,
    menus,
    panel,
    own_head_panels,
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
