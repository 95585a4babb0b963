"""Settings said once: what a user can choose, its default, its range and its words.

A group of settings is a frozen dataclass, some of whose fields are made by `setting`. From these come Blender's
properties, the options of the command line, presets and the templates for render farms.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeVar

from .reading import as_number, as_whole, shown

Group = TypeVar("Group")
Unit = Literal["", "percent", "angle", "seconds"]


class Choice(NamedTuple):
    """One of the values of a setting, and what a menu says of it."""

    value: str
    label: str
    description: str


@dataclass(frozen=True)
class Setting:
    """What a field of a group may be, and what users read of it.

    Attributes
    ----------
    default : bool, int, float or str
        As the field has it.
    label, description : str
        As a button and its tooltip show them.
    low, high : float or None
        The range of a number, as the field has it.
    soft_high : float or None
        Where a slider ends; what is typed goes further.
    unit : {"", "percent", "angle", "seconds"}
        A percentage is a fraction in the field, an angle is in radians.
    choices : sequence of Choice
        The values of a setting that is one of several.
    """

    default: Any
    label: str
    description: str = ""
    low: float | None = None
    high: float | None = None
    soft_high: float | None = None
    unit: Unit = ""
    choices: Sequence[Choice] = ()

    @property
    def scale(self) -> float:
        """What the field is multiplied by where a user reads it."""
        return 100.0 if self.unit == "percent" else 1.0

    @property
    def kind(self) -> type:
        """Of the value: bool, int, float or str."""
        return type(self.default)

    def checked(self, value: Any, name: str) -> Any:
        """`value`, as the field has it; ValueError where the setting cannot have it."""
        if self.kind is float:
            low, high = self._range()
            value = as_number(value, name, low - _ROUNDING * abs(low), high + _ROUNDING * abs(high))
            return min(max(value, low), high)
        if self.kind is int:
            return as_whole(value, name, *(int(end) for end in self._range()))
        if type(value) is not self.kind or (self.choices and value not in self.values):
            raise ValueError(f"{name} is {shown(value)}")
        return value

    @property
    def values(self) -> tuple[str, ...]:
        """What it can be chosen from."""
        return tuple(choice.value for choice in self.choices)

    def _range(self) -> tuple[float, float]:
        low, high = self.low, self.high
        return -_UNBOUNDED if low is None else low, _UNBOUNDED if high is None else high


_UNBOUNDED = 1e9
_ROUNDING = 1e-6
"""Of a number that Blender kept with seven digits."""


def setting(default: Any, label: str, description: str = "", **more: Any) -> Any:
    """A field of a group that users set; parameters as the attributes of `Setting`."""
    made = Setting(default, label, description, **more)
    return dataclasses.field(default=default, metadata={"setting": made})


def settings_of(group: type) -> Mapping[str, Setting]:
    """The settings of a group by the names of its fields; groups within it are left out."""
    return {field.name: field.metadata["setting"] for field in _fields(group) if "setting" in field.metadata}


def changed(group: Any) -> Iterator[tuple[str, Setting, Any]]:
    """Name, setting and value of those that are not as by default, in a group and in the groups within it."""
    for field in _fields(type(group)):
        value = getattr(group, field.name)
        if "setting" in field.metadata:
            if value != field.metadata["setting"].default:
                yield field.name, field.metadata["setting"], value
        elif dataclasses.is_dataclass(value):
            yield from changed(value)


def _fields(group: type) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(group)
