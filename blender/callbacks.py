"""Functions that properties of the head's rig call.

Blender 4.2 keeps them until Python has ended, and crashes when it quits if they keep `bpy` alive until then, so neither
this module nor what it imports at its top may import that.
"""

from collections.abc import Iterable
from typing import Protocol


class _Control(Protocol):
    use: bool
    order: int


class _Rig(Protocol):
    few: int
    controls: Iterable[_Control]


def use_few(group: _Rig, _: object) -> None:
    """Use as many controls as the slider says: those that help most."""
    for item in group.controls:
        item.use = item.order <= group.few
