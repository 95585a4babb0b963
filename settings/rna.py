"""Blender's properties made from settings, and settings read from them: `core/settings.py` says each once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty

from ..core.settings import Setting, settings_of

Group = TypeVar("Group")
Owner = TypeVar("Owner", bound=type[bpy.types.PropertyGroup])


def with_settings(*groups: type) -> Callable[[Owner], Owner]:
    """Give a property group, or an operator, a property for each setting of `groups`, under its field's name."""

    def decorated(owner: Owner) -> Owner:
        made = {name: property_of(setting) for group in groups for name, setting in settings_of(group).items()}
        owner.__annotations__ = made | owner.__annotations__
        return owner

    return decorated


def property_of(setting: Setting) -> Any:
    """The property of a setting, for an annotation."""
    words: dict[str, Any] = {"name": setting.label, "description": setting.description}
    if setting.choices:
        return EnumProperty(**words, items=tuple(map(tuple, setting.choices)), default=setting.default)
    if setting.kind is bool:
        return BoolProperty(**words, default=setting.default)
    ends = {"default": setting.default, "min": setting.low, "max": setting.high, "soft_max": setting.soft_high}
    shown = {name: setting.kind(end * setting.scale) for name, end in ends.items() if end is not None}
    if setting.kind is int:
        return IntProperty(**words, **shown)
    return FloatProperty(**words, **shown, **_LOOKS[setting.unit])


_LOOKS: dict[str, dict[str, Any]] = {
    "": {},
    "percent": {"subtype": "PERCENTAGE", "precision": 2},
    "angle": {"subtype": "ANGLE", "precision": 0, "step": 100},
    "seconds": {"subtype": "TIME_ABSOLUTE"},
}


def read(group: type[Group], owner: Any, **more: Any) -> Group:
    """A group of settings with the values that `owner` has, and `more` in its other fields."""
    values = {
        name: getattr(owner, name) / setting.scale if setting.scale != 1.0 else getattr(owner, name)
        for name, setting in settings_of(group).items()
    }
    return group(**values, **more)
