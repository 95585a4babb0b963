"""What operators on the active mesh share."""

import bpy

from .errors import ReportsErrors


class OnMesh(ReportsErrors):
    """Mixin: needs a mesh active, and does its `work` on it."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only with a mesh active."""
        if context.active_object is None or context.active_object.type != "MESH":
            cls.poll_message_set("Select a head mesh")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Do the work on the active mesh."""
        return self.reporting(self.work, context)


def register_all(classes: tuple[type, ...]) -> None:
    """Register `classes` in their order."""
    for cls in classes:
        bpy.utils.register_class(cls)


def unregister_all(classes: tuple[type, ...]) -> None:
    """Unregister `classes`, the last first."""
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)
