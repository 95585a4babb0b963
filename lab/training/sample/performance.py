"""The performance: which face units act at which time, and how the head moves, eased as muscles move.

Left and right are the performer's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FPS = 25
_ATTACK = 0.28


def _both(**weights: float) -> dict[str, float]:
    return {f"{name}{side}": value for name, value in weights.items() for side in ("Left", "Right")}


@dataclass(frozen=True)
class Act:
    """One expression or motion from `start` to `end`, seconds; `units` and `pose` (pitch, yaw, roll) at its height."""

    label: str
    start: float
    end: float
    units: dict[str, float]
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    attack: float = _ATTACK


_BLINK = _both(eyeBlink=1.0)

ACTS = (
    Act(
        "smile",
        1.20,
        2.10,
        _both(mouthSmile=0.85, cheekSquint=0.5, eyeSquint=0.25, mouthUpperUp=0.28) | {"jawOpen": 0.05},
    ),
    Act("mouth open", 2.20, 3.05, {"jawOpen": 0.80} | _both(browOuterUp=0.25)),
    Act("pucker", 3.15, 3.90, {"mouthPucker": 1.35, "mouthFunnel": 0.35}),
    Act("frown", 4.00, 4.80, _both(browDown=1.0, mouthFrown=0.75, eyeSquint=0.3) | {"mouthShrugLower": 0.35}),
    Act("brows up", 4.90, 5.65, _both(browOuterUp=1.0, eyeWide=0.6) | {"browInnerUp": 1.0}),
    Act("blink", 5.80, 6.06, _BLINK, attack=0.10),
    Act("blink", 6.16, 6.56, _BLINK, attack=0.12),
    Act("sneer", 6.66, 7.22, _both(noseSneer=0.9, mouthUpperUp=0.6, eyeSquint=0.5)),
    Act("turn right", 7.25, 8.15, {}, (0.0, np.radians(23.0), np.radians(1.5)), attack=0.42),
    Act("turn left", 8.10, 9.00, {}, (0.0, np.radians(-23.0), np.radians(-1.5)), attack=0.42),
    Act("nod", 8.98, 9.50, {}, (np.radians(9.0), 0.0, 0.0), attack=0.26),
    Act("nod", 9.45, 9.90, {}, (np.radians(-6.0), 0.0, 0.0), attack=0.22),
    Act("blink", 0.62, 0.82, _BLINK, attack=0.09),
    Act("blink", 9.55, 9.75, _BLINK, attack=0.09),
)
DURATION = 10.2


def times() -> NDArray[np.float64]:
    """(N,) seconds of the clip's frames."""
    return np.arange(round(DURATION * FPS)) / FPS


def units_at(time: float) -> dict[str, float]:
    """Weight, 0 to 1, of every unit that acts at `time`."""
    weights: dict[str, float] = {}
    for act in ACTS:
        share = _share(act, time)
        for name, value in act.units.items():
            weights[name] = max(weights.get(name, 0.0), share * value)
    return {name: value for name, value in weights.items() if value > 0.0}


def pose_at(time: float) -> NDArray[np.float64]:
    """Pitch, yaw and roll in radians, (3,), as in `core.base.rotation`: acted, plus the sway of a sitting person."""
    acted = sum((np.array(act.pose) * _share(act, time) for act in ACTS), np.zeros(3))
    sway = np.radians([0.9, 1.6, 0.7]) * np.sin(2.0 * np.pi * (time * np.array([0.23, 0.17, 0.13]) + [0.0, 0.3, 0.6]))
    return np.asarray(acted + sway)


def place_at(time: float) -> NDArray[np.float64]:
    """Translation in metres by which the head sways, (3,)."""
    return np.array([0.0040, 0.0022, 0.0030]) * np.sin(
        2.0 * np.pi * (time * np.array([0.11, 0.27, 0.19]) + [0.1, 0, 0.5])
    )


def labels() -> NDArray[np.str_]:
    """Name of the act of each frame, (N,), "neutral" between acts."""
    names = []
    for time in times():
        active = [act for act in ACTS if _share(act, time) > 0.5]
        names.append(active[-1].label if active else "neutral")
    return np.array(names)


def _share(act: Act, time: float) -> float:
    rise = np.clip((time - act.start) / act.attack, 0.0, 1.0)
    fall = np.clip((act.end - time) / act.attack, 0.0, 1.0)
    t = min(rise, fall)
    return float(t * t * t * (t * (6.0 * t - 15.0) + 10.0))
