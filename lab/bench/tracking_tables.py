"""The tables of `lab.bench.tracking`."""

from __future__ import annotations

import numpy as np

from lab.bench.exact import AXES, LIMITS
from lab.bench.report import Table


def tables(measured: dict[str, dict], numbers: dict) -> list[Table]:
    """Create the tables."""
    names = list(measured)
    rows = [
        (
            name,
            float(np.median(m["photos"]["raw"])),
            float(np.median(m["photos"]["removed"])),
            f"{m['photos']['lost']:.0%}",
            m["jitter"]["position"],
            m["jitter"]["second_difference"],
            m["photos"]["locate_ms"],
            m["videos"][FRONTAL_VIDEO]["ms"] if FRONTAL_VIDEO in m["videos"] else float("nan"),
        )
        for name, m in measured.items()
    ]
    columns = (
        "tracker",
        "error, %",
        "offset removed, %",
        "lost",
        "jitter",
        "second difference",
        "locate, ms",
        "track, ms",
    )
    found = [Table("Held-out people, labelled by hand", columns, rows)]
    rows = [
        (
            f"{axis}, {unit}" if unit else axis,
            value,
            *(_cell(measured[name]["axes"][axis][str(value)]) for name in names),
        )
        for axis, (unit, values) in AXES.items()
        for value in values
    ]
    title = "Re-projected faces, exact landmarks: median error, raw / offset removed (lost)"
    found.append(Table(title, ("axis", "value", *names), rows))
    apertures = [
        (name, *m["clips"]["apertures"].values(), m["clips"]["blinks"]["recall"], m["clips"]["blinks"]["precision"])
        for name, m in measured.items()
    ]
    columns = ("tracker", "lid error", "shut lids", "lid slope", "lip error", "shut lips", "lip slope")
    title = "Clips with known landmarks: apertures in % of the eye distance, and blinks"
    found.append(Table(title, (*columns, "blink recall", "blink precision"), apertures))
    rows = [
        (clip, name, c["raw"], c["removed"], f"{c['lost']:.0%}")
        for name, m in measured.items()
        for clip, c in m["clips"]["each"].items()
    ]
    found.append(
        Table("Clips with known landmarks", ("clip", "tracker", "error, %", "offset removed, %", "lost"), rows)
    )
    turning = [(name, *m["turning"].values()) for name, m in measured.items()]
    columns = ("tracker", "frames", "lost", "error above 10 %", "median error, %", "95th percentile, %")
    limits = "{:g} degrees of pitch, {:g} of yaw and {:g} of roll".format(*LIMITS)
    found.append(Table(f"Turning by up to {limits}", columns, turning))
    rows = [
        (video, name, f"{v['found']:.1%}", v["jitter"], v["ms"])
        for name, m in measured.items()
        for video, v in m["videos"].items()
    ]
    found.append(
        Table("Clips without known landmarks", ("clip", "tracker", "found", "second difference, %", "ms"), rows)
    )
    fastest = min(numbers["paces"].values())
    rows = [(name, ms, ms / fastest) for name, ms in numbers["paces"].items()]
    found.append(
        Table(
            "Trackers taking turns on each frame, sample clip, 640 x 480",
            ("tracker", "ms", "relative to the fastest"),
            rows,
        )
    )
    if "stages" in numbers:
        columns = ("", *next(iter(numbers["stages"].values())), "sum")
        rows = [(name, *times.values(), sum(times.values())) for name, times in numbers["stages"].items()]
        found.append(Table("Milliseconds per stage, sample clip", columns, rows))
        still, delays = numbers["smoothing"]["jitter"], numbers["smoothing"]["delay_ms"]
        rows = [(name, *values.values()) for name, values in still.items()]
        found.append(
            Table(
                "Jitter on a still image, without and with smoothing, % of the eye distance",
                ("", "position", "second difference"),
                rows,
            )
        )
        found.append(Table("Delay due to smoothing, ms", tuple(delays), [tuple(delays.values())]))
        columns = (
            "pixels per frame",
            "crossings",
            "tracked at the end",
            "tracked",
            "no face",
            "neither",
            "the other person",
        )
        rows = [
            (speed, c["crossings"], c["returned"], *(f"{c[k]:.1%}" for k in ("own", "nobody", "between", "other")))
            for speed, c in numbers["crossings"].items()
        ]
        found.append(Table("Another person passes in front of the tracked one", columns, rows))
    return found


FRONTAL_VIDEO = "single_face.mp4"


def _cell(level: dict) -> str:
    return f"{level['raw']:.2f} / {level['removed']:.2f} ({level['lost']:.0%})"
