"""Functions that settings call.

Blender 4.2 keeps them until Python has ended, and crashes when it quits if they keep `bpy` alive until then, so neither
this module nor what it imports at its top may import that.
"""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import bpy

_COARSEST = 2.0
"""Error of curves at no detail, in percent of the eye distance."""


class _Curves(Protocol):
    clean: float
    """Error of the curves in percent of the eye distance."""


def detail_of(bake: _Curves) -> float:
    """Return the detail of a bake's curves, 0 to 100."""
    return 100.0 * (1.0 - min(bake.clean / _COARSEST, 1.0))


def set_detail(bake: _Curves, detail: float) -> None:
    """Set the detail of a bake's curves, 0 to 100."""
    bake.clean = _COARSEST * (1.0 - detail / 100.0)


def refit_last_bake(_: object, context: "bpy.types.Context") -> None:
    """Fit the keyframes of the last bake again."""
    from ..blender.animation.refit import refit

    refit(context.scene.facemime_takes.bake.clean / 100.0)
