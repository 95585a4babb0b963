"""Blender properties for the settings that `core/files/setting.py` defines, and conversion back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..core.files.setting import Choice, Setting, settings_of

Group = TypeVar("Group")
Owner = TypeVar("Owner", bound=type)


def with_settings(*groups: Any) -> Callable[[Owner], Owner]:
    """Decorate a property group or operator with a property for each setting of `groups`, named after its field.

    The groups are types, or instances of dataclasses whose values are the defaults.
    """

    def decorate(owner: Owner) -> Owner:
        properties = {
            name: _property_of(setting if isinstance(group, type) else replace(setting, default=getattr(group, name)))
            for group in groups
            for name, setting in settings_of(group).items()
        }
        owner.__annotations__ = properties | owner.__annotations__
        return owner

    return decorate


def _property_of(setting: Setting) -> Any:
    """Return the Blender property of a setting, for an annotation."""
    texts: dict[str, Any] = {"name": setting.label, "description": setting.description}
    if setting.choices:
        return EnumProperty(**texts, items=_items(setting.choices), default=setting.default)
    if setting.kind is bool:
        return BoolProperty(**texts, default=setting.default)
    if setting.unit == "file":
        return StringProperty(**texts, default=setting.default, subtype="FILE_PATH")
    stored = {"default": setting.default, "min": setting.low, "max": setting.high, "soft_max": setting.soft_high}
    numbers = {name: setting.kind(value * setting.scale) for name, value in stored.items() if value is not None}
    if setting.kind is int:
        return IntProperty(**texts, **numbers)
    return FloatProperty(**texts, **numbers, **_DISPLAY[setting.unit])


def _items(choices: Sequence[Choice]) -> tuple[tuple[str, str, str, int], ...]:
    return tuple(
        (choice.value, choice.label, choice.description, place if choice.number < 0 else choice.number)
        for place, choice in enumerate(choices)
    )


_DISPLAY: dict[str, dict[str, Any]] = {
    "": {},
    "percent": {"subtype": "PERCENTAGE", "precision": 2},
    "angle": {"subtype": "ANGLE", "precision": 0, "step": 100},
    "seconds": {"subtype": "TIME_ABSOLUTE", "step": 1, "precision": 3},
}


def read(group: type[Group], owner: Any, **more: Any) -> Group:
    """Read a group of settings from the Blender properties of `owner`; `more` are the fields that are not settings."""
    values = {name: _value(setting, getattr(owner, name)) for name, setting in settings_of(group).items()}
    return group(**values, **more)


def _value(setting: Setting, stored: Any) -> Any:
    if setting.unit == "file":
        return bpy.path.abspath(stored)
    return stored / setting.scale if setting.scale != 1.0 else stored
