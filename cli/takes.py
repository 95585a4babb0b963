"""The commands `mend`, `export` and `import` for takes."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from ..core.bake.arkit import arkit_coefficients
from ..core.drive.retarget import anonymise
from ..core.errors import FacemimeError, SourceError
from ..core.files.capture import check_readable, write_image
from ..core.files.setting import settings_of
from ..core.heads.built_in import LOOKS, eyes_of_gaze, gaze_of
from ..core.puppet.job import HeadFile
from ..core.streams.sender import eyes_from, turned_from
from ..core.takes.coefficient_table import write_coefficient_csv
from ..core.takes.correction import learn, solve_pins, without_pins
from ..core.takes.face_models import FPS, is_moving_face, read_moving_face
from ..core.takes.file import SUFFIX, save_take
from ..core.takes.learnt import corrected
from ..core.takes.mending import Mending, draw_before_after, mend
from ..core.takes.neutral import calibrate
from ..core.takes.openface import write_openface_csv
from ..core.takes.pins import Pin, pins_of, read_pins, with_learning, with_pins, write_pins
from ..core.takes.recordings import SUFFIXES as RECORDINGS
from ..core.takes.recordings import read_recording
from ..core.takes.smooth import CUTOFFS
from ..core.takes.spreadsheet import to_csv
from ..core.takes.table_angles import AUTOMATIC, DEGREES, RADIANS
from ..core.takes.take import Take
from ..core.takes.timing import BLEND, punch_in, resample, shift_time, trim
from .bind import parse_mark
from .console import tell
from .job_files import importing_blender, load_with_warnings, outputs_of
from .options import Commands, Options, add_command, add_output, add_settings, filled, head_file, number

Span = tuple[float, float]
"""Start and end in seconds, infinite if they were omitted."""
_EVERYTHING: Span = (-math.inf, math.inf)


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    mend = add_command(
        commands,
        "mend",
        "mend a take: fill gaps, remove outliers and jitter, change its timing; applied in the order of the options",
    )
    mend.add_argument("take", type=Path, metavar="TAKE.facetake", help="the take, which is not changed")
    add_output(mend, "OUT.facetake", "the mended take")
    mend.add_argument(
        "--pins",
        type=Path,
        metavar="PINS.csv|OTHER.facetake",
        help="add pins: landmarks put in their places, from a table or another take; takes.md lists the columns",
    )
    mend.add_argument("--learn", action="store_true", help="also correct frames that look like those with pins")
    mend.add_argument(
        "--learn-from",
        type=Path,
        metavar="OTHER.facetake",
        help="correct frames that look like those with pins in another take of this performer",
    )
    mend.add_argument("--punch-in", type=Path, metavar="OTHER.facetake", help="insert a part of another take")
    mend.add_argument("--at", type=parse_span, metavar="A:B", help="span to insert, in seconds (the whole other take)")
    mend.add_argument(
        "--blend",
        type=number,
        default=BLEND,
        metavar="S",
        help=f"seconds over which the takes blend into each other ({BLEND:g})",
    )
    add_settings(mend, Mending, without=("gaps", "smoothing"))
    gaps = mend.add_mutually_exclusive_group()
    for how, summary in (("bridge", "interpolate gaps without a face"), ("hold", "hold the last face in gaps")):
        gaps.add_argument(f"--{how}", dest="gaps", action="store_const", const=how, default=Mending.gaps, help=summary)
    smoothing = settings_of(Mending)["smoothing"]
    mend.add_argument(
        "--smooth",
        dest="smoothing",
        choices=smoothing.values,
        default=smoothing.default,
        help=f"smooth as live, or without delay ({smoothing.default})",
    )
    cutoffs = ",".join(f"{part}={cutoff:g}" for part, cutoff in CUTOFFS.items())
    mend.add_argument(
        "--cutoff",
        dest="cutoffs",
        type=parse_cutoffs,
        default={},
        metavar="PART=HZ,...",
        help=f"cutoffs for zero-phase ({cutoffs})",
    )
    mend.add_argument("--neutral", type=number, metavar="S", help="use the face at this time as the neutral face")
    mend.add_argument(
        "--trim",
        type=parse_span,
        metavar="A:B",
        help="keep this span in seconds; A or B may be omitted (--trim=-1:4 if A is negative)",
    )
    mend.add_argument("--shift", type=float, default=0.0, metavar="S", help="shift the take to later times, in seconds")
    mend.add_argument("--rate", type=float, metavar="FPS", help="resample to an even rate")
    mend.add_argument("--anonymous", action="store_true", help="remove names, dates and the shape of the face")
    mend.add_argument("--figure", type=Path, metavar="CURVES.png", help="also draw the motion before and after")
    mend.set_defaults(run=_run_mend)

    export = add_command(commands, "export", "write a take as a CSV table")
    export.add_argument("take", type=Path, metavar="TAKE.facetake", help="a take, from track")
    add_output(export, "OUT.csv", "a table with one row per frame; takes.md lists the columns")
    export.add_argument(
        "--columns",
        choices=("all", "coefficients", "livelink", "openface", "pins"),
        default="all",
        help="all data of the take; ARKit's coefficients by name; these in the format of Live Link Face; OpenFace's "
        "action units; or the pins (all)",
    )
    export.add_argument(
        "--rate", type=number, default=60.0, metavar="FPS", help="rate of Live Link Face's timecode (60)"
    )
    export.set_defaults(run=_run_export)

    read = add_command(commands, "import", "write a recording of another program or an animation as a take")
    read.add_argument(
        "source",
        type=head_file,
        metavar="RECORDING|ANIMATION[:OBJECT]",
        help="a table from export, possibly with fewer columns, or one of ARKit's coefficients from Live Link Face or "
        "another program; Audio2Face's .json, Face Cap's .txt, OpenFace's .csv or Unity's .anim; the first of numbered "
        ".obj or .ply meshes, or their folder; parameters of FLAME, SMPL-X or GNM (.npz, .npy, .pkl), with --model; "
        "or a file, as for bind, in which a face moves, and any mesh of the character (the most likely face)",
    )
    add_output(read, "OUT.facetake", "the take")
    read.add_argument("--clip", default="", metavar="NAME", help="the clip of an animation to sample (what plays)")
    read.add_argument(
        "--angles",
        choices=(AUTOMATIC, RADIANS, DEGREES),
        default=AUTOMATIC,
        help="unit of the rotation of the head in a table (decided by its values)",
    )
    read.add_argument(
        "--model", type=Path, metavar="FILE", help="the model of parameters: FLAME's .pkl or .npz, or GNM's .npz"
    )
    read.add_argument(
        "--fps",
        type=number,
        metavar="FPS",
        help="rate of meshes and parameters, and of tables without times or whose timecodes count frames (that of the "
        f"file, or {FPS:g})",
    )
    read.add_argument(
        "--mark",
        type=parse_mark,
        action="append",
        default=[],
        metavar="POINT=VERTEX",
        help="a point of the face on the first mesh or the model, as for bind, by vertex",
    )
    read.set_defaults(run=_run_import)


def _run_mend(given: Options) -> int:
    """Run `facemime mend`: mend a take; returns the exit status."""
    outputs = ((given["output"], {SUFFIX}), (given["figure"], {".png", ".jpg"}))
    inputs = {"the take that is mended": given["take"], "the take that is inserted": given["punch_in"]}
    inputs |= {"the pins": given["pins"], "the take that is learnt from": given["learn_from"]}
    with outputs_of(outputs, inputs):
        take = load_with_warnings(given["take"], solved=False)
        mended = _mended(_pinned(take, given), given)
        save_take(mended, given["output"])
        if given["figure"] is not None:
            write_image(given["figure"], draw_before_after(solve_pins(take), solve_pins(mended)))
    lost = len(mended) - int(mended.found.sum())
    tell(f"{len(mended)} frames, {lost} without a face ({len(take) - int(take.found.sum())} before)")
    return 0


def _pinned(take: Take, given: Options) -> Take:
    """Return a take with what pins of others add to it; its own stay removable."""
    if given["learn_from"] is not None:
        learnt = learn(load_with_warnings(given["learn_from"], solved=False))
        if not learnt:
            raise SourceError(
                "The pins of {path} tell nothing about other frames, as those of one frame do not predict those of "
                "another. Pin the same part of the face in more frames, or leave out --learn-from.",
                path=given["learn_from"],
            )
        take = corrected(take, learnt)
    if given["pins"] is not None:
        take = with_pins(take, [*pins_of(take), *_pins_in(given["pins"])])
    if given["learn"]:
        if not pins_of(take):
            raise FacemimeError("--learn needs pins, and the take has none. Add --pins.")
        take = with_learning(take, True)
    return take


def _pins_in(path: Path) -> tuple[Pin, ...]:
    """Return the pins of a table or a take; SourceError if it has no pins."""
    is_take = path.suffix.lower() == SUFFIX
    pins = pins_of(load_with_warnings(path, solved=False)) if is_take else read_pins(path)
    if not pins:
        raise SourceError("There are no pins in {path}. Choose another file.", path=path)
    return pins


def _mended(take: Take, given: Options) -> Take:
    if given["at"] is not None and given["punch_in"] is None:
        raise FacemimeError("--at needs another take to insert. Add --punch-in.")
    if given["cutoffs"] and given["smoothing"] != "zero-phase":
        raise FacemimeError("--cutoff is for smoothing without delay. Add --smooth zero-phase.")
    if given["punch_in"] is not None:
        insert = load_with_warnings(given["punch_in"], solved=False)
        start, end = _EVERYTHING if given["at"] is None else given["at"]
        start = start if math.isfinite(start) else float(insert.times[0])
        end = end if math.isfinite(end) else float(insert.times[-1])
        take = punch_in(take, insert, start, end, given["blend"])
    take = mend(take, filled(Mending, given))
    if given["trim"] is not None:
        take = trim(take, *given["trim"])
    if given["shift"]:
        take = shift_time(take, given["shift"])
    if given["rate"] is not None:
        take = resample(take, given["rate"])
    return anonymise(take) if given["anonymous"] else take


def _run_export(given: Options) -> int:
    """Run `facemime export`: write a take as a table; returns the exit status."""
    with outputs_of(((given["output"], {".csv"}),), {"the take that is exported": given["take"]}):
        take = load_with_warnings(given["take"], solved=False)
        if given["columns"] == "pins":
            write_pins(pins_of(take), given["output"])
        elif given["columns"] == "all":
            to_csv(without_pins(take), given["output"])
        else:
            _export_coefficients(without_pins(take), given["output"], given["columns"], given["rate"])
    return 0


def _export_coefficients(take: Take, output: Path, columns: str, rate: float) -> None:
    if not 1.0 <= rate <= 200.0:
        raise FacemimeError("The rate of a timecode cannot be {rate:g}. Use one between 1 and 200.", rate=rate)
    neutral = calibrate(take)
    if neutral.warning:
        tell(f"facemime: {neutral.warning}")
    values = arkit_coefficients(take, neutral)
    if columns == "openface":
        write_openface_csv(output, take, neutral, values)
        return
    seen = take.part(take.found)
    results = [seen.result(frame) for frame in range(len(seen))]
    turns = np.array([turned_from(result, neutral) for result in results])
    looks = [eyes_from(result, neutral) for result in results]
    eyes = [
        eyes_of_gaze(*gaze_of(row[LOOKS])) if look is None else look for look, row in zip(looks, values, strict=True)
    ]
    live_link = columns == "livelink"
    write_coefficient_csv(output, seen.times, values, turns, np.array(eyes), live_link=live_link, rate=rate)


def _run_import(given: Options) -> int:
    """Run `facemime import`: write a recording, or the motion of a face in an animation, as a take."""
    source, clip, fps = given["source"], given["clip"], given["fps"]
    is_moving = is_moving_face(source.path)
    is_recording = source.path.suffix.lower() in RECORDINGS and not is_moving
    if (is_recording or is_moving) and clip:
        raise FacemimeError("A recording has no clips. Leave out --clip.")
    if not (is_recording or is_moving) and fps is not None:
        raise FacemimeError("An animation has times of its own. Leave out --fps.")
    described = "the animation that is imported" if not is_recording else "the recording that is imported"
    inputs = {"the model": given["model"]} | ({} if os.path.isdir(source.path) else {described: source.path})
    with outputs_of(((given["output"], {SUFFIX}),), inputs):
        if is_moving:
            marks = {point: place for point, place in given["mark"] if isinstance(place, int)}
            if len(marks) < len(given["mark"]):
                raise FacemimeError("Points of numbered meshes and models are vertices. Use --mark POINT=VERTEX.")
            take = read_moving_face(source.path, fps, given["model"], marks)
        else:
            check_readable(source.path)
            take = read_recording(source.path, given["angles"], fps) if is_recording else _sampled(source, clip)
        save_take(take, given["output"])
    for note in take.info.get("notes", []):
        tell(f"facemime: {note}")
    return 0


def _sampled(animation: HeadFile, clip: str) -> Take:
    with importing_blender("An animation", "import ..."):
        from .character import sample
    return sample(animation, clip)


def parse_span(text: str) -> Span:
    """Parse a span `A:B` in seconds, either end of which may be omitted.

    Raises FacemimeError if it is not a span, or is empty.
    """
    first, colon, last = text.partition(":")
    try:
        start, end = float(first) if first else -math.inf, float(last) if last else math.inf
    except ValueError:
        colon = ""
    if not colon or not start < end:
        raise FacemimeError("{text!r} is not a time span. Use seconds, as in 1.5:4, 1.5: or :4.", text=text)
    return start, end


def parse_cutoffs(text: str) -> dict[str, float]:
    """Parse cutoffs in Hz by part, as in `mouth=6,jaw=4`; FacemimeError if it is anything else."""
    cutoffs = {}
    for item in filter(None, text.split(",")):
        part, _, value = item.partition("=")
        try:
            cutoffs[part.strip()] = float(value)
        except ValueError:
            raise FacemimeError("{item!r} is not a cutoff. Use the form mouth=6,jaw=4.", item=item) from None
    return cutoffs
