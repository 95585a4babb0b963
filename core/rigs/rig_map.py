"""What the controls of a rig do to a face, as measured by moving each a little (method.md, section 9.7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..face.landmarks import BROWS, EYE_LEFT, EYE_RIGHT, JAW, LIPS, N_LANDMARKS, NOSE
from ..heads.symmetry import Symmetry
from ..numeric.arrays import FloatArray, IntArray
from .control_names import REGION_OF, role_of

LOCATION, ROTATION, SCALE, PROPERTY = "location", "rotation", "scale", "property"
"""Kinds of channels."""
REGIONS: Mapping[str, IntArray] = {
    "Brows": BROWS,
    "Eyes": np.concatenate([EYE_RIGHT, EYE_LEFT]),
    "Nose": NOSE,
    "Mouth": LIPS,
    "Jaw": JAW,
}
"""Landmarks of each region."""
_REACH: Mapping[str, float] = {LOCATION: 0.5, ROTATION: np.radians(30.0), SCALE: 0.5}
"""Largest change from rest without a limit, in eye distances, radians and shares of the size: farther away, what was
measured near rest says little."""
_SYMMETRIC = 0.25
"""Difference of the effects of both directions, relative to their sum, up to which a channel is one variable."""
_NAMED = 0.5
"""Motion of the region of a control's name, relative to the largest of any, above which the control belongs there."""
_EFFECT = 0.02
"""Motion of the face below which a direction of a channel does nothing, in eye distances."""
_ALIKE = 0.8
"""Cosine of the effects of two channels, one mirrored, from which they mirror each other."""


@dataclass(frozen=True)
class RigChannel:
    """A number of a rig: a coordinate of a control, or a property.

    Attributes
    ----------
    owner : str
        Name of the object that has it.
    bone : str
        Name of the control bone; "" for the object itself.
    kind : str
        `LOCATION`, `ROTATION`, `SCALE` or `PROPERTY`.
    index : int
        Axis of a location, rotation or scale.
    name : str
        Name of the property.
    low, high : float
        Smallest and largest value relative to rest: in the unit of the channel, infinite without limits.
    rest : float
        Value at rest: 0 of a rotation, 1 of a scale.
    unit : float
        The eye distance in the unit of a location.
    label : str
        What the object was called when its controls were learnt; "" if that is its name.
    """

    owner: str
    bone: str
    kind: str
    index: int = 0
    name: str = ""
    low: float = -np.inf
    high: float = np.inf
    rest: float = 0.0
    unit: float = 1.0
    label: str = ""

    @property
    def control(self) -> str:
        """Name of the control, which may have several channels; the same on a copy of the rig."""
        return self.bone or self.name or self.label or self.owner

    @property
    def place(self) -> tuple[str, str, str, int, str]:
        """What tells the channel from all others of a scene."""
        return self.owner, self.bone, self.kind, self.index, self.name

    @property
    def key(self) -> str:
        """Name of the channel, which is the same on a copy of the rig."""
        return f"{self.control} {self.kind} {self.name or 'xyz'[self.index]}"


@dataclass(frozen=True)
class Probe:
    """A channel that was moved from rest by `step`, and the displacements (S, 3) of the sampled vertices: head frame,
    unit of the mesh.
    """

    step: float
    moved: FloatArray


@dataclass(frozen=True)
class RigMap:
    """Linear model of a rig: ``moved = sum_k x_k effects_k`` with ``lower <= x <= upper``.

    Attributes
    ----------
    channels : tuple of RigChannel
        The C channels.
    sample : (S,) intp
        The vertices that are looked at: the 66 landmarks, then others of the face.
    channel : (K,) intp
        Channel of each variable. A channel whose directions differ has two variables, of which one is 0.
    scale : (K,) float64
        Change of the channel by a variable at 1; negative for the lower of two directions.
    effects : (K, S, 3) float64
        Displacements by each variable at 1: head frame, unit of the mesh.
    lower, upper : (K,) float64
        Bounds, which contain 0.
    doubt : (K,) float64
        How far each is from linear: the difference of the effects of both directions of a location without limits,
        relative to their sum.
    unit : float
        Outer-eye distance of the head in the unit of the mesh.
    """

    channels: tuple[RigChannel, ...]
    sample: IntArray
    channel: IntArray
    scale: FloatArray
    effects: FloatArray
    lower: FloatArray
    upper: FloatArray
    doubt: FloatArray
    unit: float

    @property
    def controls(self) -> list[str]:
        """Names of the controls."""
        return list(dict.fromkeys(channel.control for channel in self.channels))

    @property
    def opposite(self) -> NDArray[np.intp]:
        """The other direction of the channel of each variable, (K,); -1 if it has one variable."""
        found = np.full(len(self.channel), -1, dtype=np.intp)
        for channel in np.unique(self.channel):
            pair = np.flatnonzero(self.channel == channel)
            if len(pair) == 2:
                found[pair] = pair[::-1]
        return found

    @property
    def regions(self) -> dict[str, str]:
        """Region of the face, a key of `REGIONS`, that each control moves most, by its name."""
        size = np.linalg.norm(self.effects[:, :N_LANDMARKS], axis=2)
        moved = {name: size[:, points].max(axis=1, initial=0.0) for name, points in REGIONS.items()}
        found: dict[str, dict[str, float]] = {}
        for k, channel in enumerate(self.channel.tolist()):
            best = found.setdefault(self.channels[channel].control, dict.fromkeys(REGIONS, 0.0))
            for name in REGIONS:
                best[name] = max(best[name], float(moved[name][k]))
        return {control: _region(control, best) for control, best in found.items()}

    def values(self, variables: FloatArray) -> FloatArray:
        """Convert variables (..., K) to changes of the channels from rest, (..., C)."""
        shares = np.zeros((len(self.channel), len(self.channels)))
        shares[np.arange(len(self.channel)), self.channel] = self.scale
        return np.asarray(variables @ shares)

    def of_landmarks(self) -> RigMap:
        """Return the map of the landmarks alone."""
        return replace(self, sample=self.sample[:N_LANDMARKS], effects=self.effects[:, :N_LANDMARKS])

    def chosen(self, wanted: NDArray[np.bool_]) -> RigMap:
        """Return the map of some of the channels, (C,)."""
        kept = wanted[self.channel]
        numbers = np.cumsum(wanted) - 1
        return replace(
            self,
            channels=tuple(channel for channel, use in zip(self.channels, wanted.tolist(), strict=True) if use),
            channel=numbers[self.channel[kept]],
            scale=self.scale[kept],
            effects=self.effects[kept],
            lower=self.lower[kept],
            upper=self.upper[kept],
            doubt=self.doubt[kept],
        )


def _region(control: str, moved: Mapping[str, float]) -> str:
    """Region that a control moves most, or that of its name if it moves that nearly as much."""
    most = max(moved, key=lambda name: moved[name])
    named = REGION_OF.get(role_of(control), most)
    return named if moved[named] > _NAMED * moved[most] else most


def map_of(channels: Sequence[RigChannel], probes: Sequence[Sequence[Probe]], sample: IntArray, unit: float) -> RigMap:
    """Build a map from the probes of each channel, one for each direction in which it can move.

    Channels that do not move the face are left out.
    """
    kept: list[RigChannel] = []
    rows: list[tuple[int, float, FloatArray, float, float, float]] = []
    for channel, probed in zip(channels, probes, strict=True):
        variables = [_variable(channel, probe) for probe in probed if _acts(probe, unit)]
        doubt = _difference(*probed) if len(variables) == 2 and _is_free(channel) else 0.0
        if len(variables) == 2 and _difference(*probed) < _SYMMETRIC:
            variables = [_joined(*variables)]
        rows += [(len(kept), *variable, doubt) for variable in variables]
        kept += [channel] if variables else []
    columns = (list(column) for column in zip(*rows, strict=True)) if rows else [[]] * 6
    numbers, scale, effects, lower, upper, doubts = columns
    return RigMap(
        tuple(kept),
        sample,
        np.array(numbers, dtype=np.intp),
        np.array(scale, dtype=np.float64),
        np.array(effects, dtype=np.float64).reshape(len(rows), len(sample), 3),
        np.array(lower, dtype=np.float64),
        np.array(upper, dtype=np.float64),
        np.array(doubts, dtype=np.float64),
        unit,
    )


def _acts(probe: Probe, unit: float) -> bool:
    """Whether a direction moves the face."""
    return bool(np.linalg.norm(probe.moved, axis=1).max() > _EFFECT * unit)


def _variable(channel: RigChannel, probe: Probe) -> tuple[float, FloatArray, float, float]:
    """Scale, effect and bounds of the variable for a direction."""
    size, limit = abs(probe.step), float(channel.high if probe.step > 0.0 else -channel.low)
    reach = float(_REACH.get(channel.kind, np.inf)) * (channel.unit if channel.kind == LOCATION else 1.0)
    farthest: float = min(limit, max(reach, size))
    return probe.step, probe.moved, 0.0, farthest / size


def _difference(one: Probe, other: Probe) -> float:
    """Difference of the effects of both directions, relative to their sum."""
    a, b = one.moved / one.step, other.moved / other.step
    return float(np.linalg.norm(a - b)) / max(float(np.linalg.norm(a + b)), 1e-30)


def _is_free(channel: RigChannel) -> bool:
    """Whether a channel is a location without limits."""
    return channel.kind == LOCATION and not np.isfinite(channel.low) and not np.isfinite(channel.high)


def _joined(
    one: tuple[float, FloatArray, float, float], other: tuple[float, FloatArray, float, float]
) -> tuple[float, FloatArray, float, float]:
    """One variable for both directions of a channel."""
    up, down = (one, other) if one[0] > 0.0 else (other, one)
    step = 0.5 * (up[0] - down[0])
    effect = 0.5 * step * (up[1] / up[0] + down[1] / down[0])
    return step, effect, -down[3] * -down[0] / step, up[3] * up[0] / step


def even_probes(probes: Sequence[Sequence[Probe]], symmetry: Symmetry) -> list[list[Probe]]:
    """Give directions of channels that mirror each other the mean of both effects; a rig is never quite symmetric.

    They are recognised by what they do, not by their names: each is the other's nearest mirror image.
    """
    flat = [probe for probed in probes for probe in probed]
    if not flat:
        return [list(probed) for probed in probes]
    rates = np.array([probe.moved / abs(probe.step) for probe in flat])
    mirrored = symmetry.mirrored(rates)
    rows, images = rates.reshape(len(flat), -1), mirrored.reshape(len(flat), -1)
    sizes = np.maximum(np.linalg.norm(rows, axis=1), 1e-30)
    alike = rows @ images.T / np.outer(sizes, sizes)
    nearest = alike.argmax(axis=1)
    mutual = (nearest[nearest] == np.arange(len(flat))) & (alike.max(axis=1) > _ALIKE)
    even = list(flat)
    for number in np.flatnonzero(mutual).tolist():
        own, other = flat[number], int(nearest[number])
        step = 0.5 * (abs(own.step) + abs(flat[other].step))
        rate = 0.5 * (rates[number] + mirrored[other])
        even[number] = Probe(float(np.copysign(step, own.step)), rate * step)
    left = iter(even)
    return [[next(left) for _ in probed] for probed in probes]
