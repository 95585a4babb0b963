"""What only the stubs of Blender's types have, for annotations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import bpy

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import EventTypeItems, IconItems, OperatorReturnItems, WmReportItems

    AlphaMode = Literal["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"]
    EventType = EventTypeItems
    Icon = IconItems
    ReportLevel = WmReportItems
    OperatorResult = set[OperatorReturnItems]
    OperatorMixin = bpy.types.Operator
    ListMixin = bpy.types.UIList
    MenuMixin = bpy.types.Menu
    PanelMixin = bpy.types.Panel
else:
    AlphaMode = EventType = Icon = ReportLevel = str
    OperatorResult = set
    ListMixin = MenuMixin = OperatorMixin = PanelMixin = object  # Blender registers classes with one base of its own
