"""Settings, each defined once: its default, range, unit, label and description.

A group of settings is a frozen dataclass, some of whose fields are made by `setting`. Blender's properties, the options
of the command line, presets and the templates for render farms are derived from them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeVar

from ..errors import DataError
from .reading import as_integer, as_number, as_text, shown

Group = TypeVar("Group")
Unit = Literal["", "percent", "angle", "seconds", "file"]


class Choice(NamedTuple):
    """A value of an enumerated setting, with the texts of the menu item and of its tooltip.

    `number` is what a .blend file stores; by default the position among the choices.
    """

    value: str
    label: str
    description: str
    number: int = -1


@dataclass(frozen=True)
class Setting:
    """The values that a field of a group can have, and the texts that describe it to users.

    Attributes
    ----------
    default : bool, int, float or str
        Default value, in the unit of the field.
    label, description : str
        Text of the button, and its tooltip.
    low, high : float or None
        Range of a number, in the unit of the field.
    soft_high : float or None
        Upper end of the slider; larger values can be typed.
    unit : {"", "percent", "angle", "seconds", "file"}
        A percentage is stored as a fraction, an angle in radians, a file as its path.
    choices : sequence of Choice
        Allowed values of an enumeration.
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
        """Factor from the value of the field to the number that the user sees."""
        return 100.0 if self.unit == "percent" else 1.0

    @property
    def kind(self) -> type:
        """Type of the value: bool, int, float or str."""
        return type(self.default)

    def checked(self, value: Any, name: str) -> Any:
        """Return a value, in the unit of the field, as the field stores it; raises ValueError if it cannot have it."""
        if self.kind is float:
            low, high = self._range()
            value = as_number(value, name, low - _ROUNDING * abs(low), high + _ROUNDING * abs(high))
            return min(max(value, low), high)
        if self.kind is int:
            return as_integer(value, name, *(int(end) for end in self._range()))
        if self.unit == "file":
            return as_text(value, name, _MAX_PATH)
        if type(value) is not self.kind or (self.choices and value not in self.values):
            raise DataError("{name} cannot be {value}", name=name, value=shown(value))
        return value

    @property
    def values(self) -> tuple[str, ...]:
        """Allowed values of an enumeration."""
        return tuple(choice.value for choice in self.choices)

    def _range(self) -> tuple[float, float]:
        low, high = self.low, self.high
        return -_UNBOUNDED if low is None else low, _UNBOUNDED if high is None else high


_UNBOUNDED = 1e9
_MAX_PATH = 4096
"""Largest length of a path in characters, that of Linux; Blender stores 1024."""
_ROUNDING = 1e-6
"""Relative tolerance at the ends of a range, as Blender stores numbers with seven digits."""


def setting(default: Any, label: str, description: str = "", **more: Any) -> Any:
    """Declare a field of a group as a setting, with the attributes of a `Setting`."""
    metadata = {"setting": Setting(default, label, description, **more)}
    return dataclasses.field(default=default, metadata=metadata)


def settings_of(group: Any) -> Mapping[str, Setting]:
    """Return the settings of a group or its instance by field name, without those of nested groups."""
    return {field.name: field.metadata["setting"] for field in dataclasses.fields(group) if "setting" in field.metadata}


def changed(group: Any) -> Iterator[tuple[str, Setting, Any]]:
    """Yield name, setting and value of every setting that differs from its default, including nested groups."""
    for field in dataclasses.fields(group):
        value = getattr(group, field.name)
        if "setting" in field.metadata:
            if value != field.metadata["setting"].default:
                yield field.name, field.metadata["setting"], value
        elif dataclasses.is_dataclass(value):
            yield from changed(value)
