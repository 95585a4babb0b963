"""What the panels of the sidebar's tab share: where they stand, and their order, which is the order of the work."""

ORDER = ("head", "source", "calibration", "regions", "control_points", "expression", "puppet", "takes")
"""Modules of `ui` whose panels stand in the tab, from above."""


def place(module: str) -> int:
    """For `bl_order`: the place of the panel of `ui.<module>`; its `__name__` will do."""
    return ORDER.index(module.rpartition(".")[2])


class Sidebar:
    """Mixin: a panel of the tab Facemime."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Facemime"
