"""Unity's animation clips as text (`.anim`): the curves of blend shapes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..files.reading import read_text
from ..numeric.arrays import FloatArray
from .curves import CoefficientTrack, coefficients_of_keys

_RATE = 60.0
"""Frames per second of a clip that states none, as Unity's editor has."""
_FASTEST = 1000.0
"""Largest number of frames per second that a clip may state."""
_MAX_FRAMES = 1_000_000
_FULL = 100.0
"""Weight at which a blend shape is fully shown."""
_HEADER = "%YAML"
_CURVE = re.compile(r"^  - (?:serializedVersion|curve|attribute|path|classID):", re.MULTILINE)
_ATTRIBUTE = re.compile(r"^    attribute: (?:'|\")?blendShape\.(.+?)(?:'|\")?\s*$", re.MULTILINE)
_KEY = re.compile(r"^[\s-]+time: (\S+)\s+value: (\S+)\s+inSlope: (\S+)\s+outSlope: (\S+)", re.MULTILINE)
_SAMPLES = re.compile(r"^  m_SampleRate: (\S+)", re.MULTILINE)


def read_unity_clip(path: Path) -> CoefficientTrack:
    """Read a clip that Unity saved as text; ValueError if it is anything else, OSError if it cannot be read."""
    text = read_text(path)
    if not text.startswith(_HEADER) or "AnimationClip:" not in text:
        raise DataError("it is not a clip that Unity saved as text (Edit > Project Settings > Editor > Force Text)")
    body = text.partition("  m_FloatCurves:")[2]
    body = body[: match.start()] if (match := re.search(r"^  m_\w+:", body, re.MULTILINE)) else body
    starts = [match.start() for match in _CURVE.finditer(body)]
    keys: dict[str, FloatArray] = {}
    for start, end in zip(starts, [*starts[1:], len(body)], strict=True):
        curve = "  " + body[start + 2 : end].replace("- ", "  ", 1)
        if (named := _ATTRIBUTE.search(curve)) is not None:
            points = np.array([[_number(cell) for cell in key] for key in _KEY.findall(curve)]).reshape(-1, 4)
            if len(points):  # the first mesh counts, as others that have the same key show the same
                keys.setdefault(named[1], points[np.argsort(points[:, 0], kind="stable")])
    if not keys:
        raise DataError("it has no curves of blend shapes")
    rate = _number(match[1]) if (match := _SAMPLES.search(text)) else _RATE
    if not 0.0 < rate <= _FASTEST:
        raise DataError("it states {rate:g} frames per second", rate=rate)
    first, last = min(of[0, 0] for of in keys.values()), max(of[-1, 0] for of in keys.values())
    if (last - first) * rate > _MAX_FRAMES:
        raise DataError("it has more than {max_frames:,} frames", max_frames=_MAX_FRAMES)
    times = first + np.arange(round((last - first) * rate) + 1) / rate
    curves = {name: _sampled(of, times) / _FULL for name, of in keys.items()}
    values, notes = coefficients_of_keys(curves)
    return CoefficientTrack(times, values, notes=notes)


def _number(text: str) -> float:
    """Read a number, or a slope, which is infinite where a curve jumps."""
    value = float(text.replace("Infinity", "inf"))
    if np.isnan(value):
        raise DataError("it has values that are not possible numbers")
    return value


def _sampled(keys: FloatArray, times: FloatArray) -> FloatArray:
    """Evaluate a curve of keys (K, 4), time, value and slopes before and after, which is a cubic between two keys."""
    places = np.clip(np.searchsorted(keys[:, 0], times, side="right") - 1, 0, max(len(keys) - 2, 0))
    if len(keys) == 1:
        return np.full(len(times), keys[0, 1])
    begin, end = keys[places], keys[places + 1]
    span = np.maximum(end[:, 0] - begin[:, 0], 1e-9)
    at = np.clip((times - begin[:, 0]) / span, 0.0, 1.0)
    jumps = ~np.isfinite(begin[:, 3]) | ~np.isfinite(end[:, 2])
    leave, arrive = (np.where(jumps, 0.0, slope) * span for slope in (begin[:, 3], end[:, 2]))
    smooth = at * at * (3.0 - 2.0 * at)
    bend = at * (1.0 - at) * ((1.0 - at) * leave - at * arrive)
    curve = begin[:, 1] + smooth * (end[:, 1] - begin[:, 1]) + bend
    return np.asarray(np.where(jumps, np.where(at < 1.0, begin[:, 1], end[:, 1]), curve))
