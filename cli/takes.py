"""The commands `mend`, `export` and `import` for takes."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..core.bake.arkit import arkit_coefficients
from ..core.capture import check_readable
from ..core.drive.anonymous import anonymise
from ..core.errors import FacemimeError
from ..core.images import write_image
from ..core.puppet.job import HeadFile
from ..core.streams.sender import turned_from
from ..core.takes.coefficient_table import from_any_csv, write_coefficient_csv
from ..core.takes.figure import draw_before_after
from ..core.takes.file import SUFFIX, save_take
from ..core.takes.mending import Mending, mend
from ..core.takes.neutral import calibrate
from ..core.takes.smooth import CUTOFFS
from ..core.takes.spreadsheet import to_csv
from ..core.takes.take import Take
from ..core.takes.timing import punch_in, resample, shift_time, trim
from .terminal.console import tell
from .terminal.options import Commands, add_command, add_output, head_file, number
from .terminal.outputs import outputs_of
from .terminal.stopping import STOPPING
from .terminal.takes import load_with_warnings


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    mend = add_command(commands, "mend", "mend a take: gaps, outliers, jitter, timing; in the order of the options")
    mend.add_argument("take", type=Path, metavar="TAKE.facetake", help="the take, which is not changed")
    add_output(mend, "OUT.facetake", "the mended take")
    mend.add_argument("--punch-in", type=Path, metavar="OTHER.facetake", help="insert a part of another take")
    mend.add_argument("--at", metavar="A:B", help="span to insert, in seconds (the whole other take)")
    mend.add_argument(
        "--blend",
        type=number,
        default=0.2,
        metavar="S",
        help="seconds over which the takes blend into each other (0.2)",
    )
    mend.add_argument("--outliers", action="store_true", help="remove outliers")
    gaps = mend.add_mutually_exclusive_group()
    gaps.add_argument("--bridge", action="store_true", help="interpolate gaps without a face")
    gaps.add_argument("--hold", action="store_true", help="hold the last face in gaps without one")
    mend.add_argument("--longest", type=float, default=1.0, metavar="S", help="longest gap to fill, in seconds (1)")
    mend.add_argument(
        "--smooth",
        choices=("none", "one-euro", "zero-phase"),
        default="none",
        help="smooth as live, or without delay (none)",
    )
    cutoffs = ",".join(f"{part}={cutoff:g}" for part, cutoff in CUTOFFS.items())
    mend.add_argument("--cutoff", default="", metavar="PART=HZ,...", help=f"cutoffs for zero-phase ({cutoffs})")
    mend.add_argument("--mirror", action="store_true", help="swap left and right")
    mend.add_argument("--neutral", type=number, metavar="S", help="use the face at this time as the neutral face")
    mend.add_argument(
        "--trim", metavar="A:B", help="keep this span in seconds; A or B may be omitted (--trim=-1:4 if A is negative)"
    )
    mend.add_argument("--shift", type=float, default=0.0, metavar="S", help="shift the take to later times, in seconds")
    mend.add_argument("--rate", type=float, metavar="FPS", help="resample to an even rate")
    mend.add_argument("--anonymous", action="store_true", help="remove names, dates and the shape of the face")
    mend.add_argument("--figure", type=Path, metavar="CURVES.png", help="also draw the motion before and after")
    mend.set_defaults(run=run_mend)

    export = add_command(commands, "export", "write a take as a table of comma-separated values")
    export.add_argument("take", type=Path, metavar="TAKE.facetake", help="a take, from track")
    add_output(export, "OUT.csv", "a table with one row per frame; docs/takes.md lists the columns")
    export.add_argument(
        "--columns",
        choices=("all", "coefficients", "livelink"),
        default="all",
        help="everything that a take has; ARKit's coefficients by name; or these as Live Link Face writes them (all)",
    )
    export.add_argument(
        "--rate", type=number, default=60.0, metavar="FPS", help="rate of Live Link Face's timecode (60)"
    )
    export.set_defaults(run=run_export)

    read = add_command(commands, "import", "write a table or an animation as a take")
    read.add_argument(
        "source",
        type=head_file,
        metavar="TABLE.csv|ANIMATION[:OBJECT]",
        help="a table as export writes it, or with fewer columns, or of ARKit's coefficients, as Live Link Face and "
        "others write them; or a .blend, .abc, .usd, .glb, .gltf or .fbx file in "
        "which a face moves, and any mesh of the character (the most likely face)",
    )
    add_output(read, "OUT.facetake", "the take")
    read.set_defaults(run=run_import)


def run_mend(arguments: argparse.Namespace) -> int:
    """Run `facemime mend`: mend a take."""
    outputs = ((arguments.output, {SUFFIX}), (arguments.figure, {".png", ".jpg"}))
    inputs = {"the take that is mended": arguments.take, "the take that is inserted": arguments.punch_in}
    with outputs_of(outputs, inputs):
        take = load_with_warnings(arguments.take)
        mended = _mended(take, arguments)
        save_take(mended, arguments.output)
        if arguments.figure is not None:
            write_image(arguments.figure, draw_before_after(take, mended))
    lost = len(mended) - int(mended.found.sum())
    tell(f"{len(mended)} frames, {lost} without a face ({len(take) - int(take.found.sum())} before)")
    return 0


def _mended(take: Take, arguments: argparse.Namespace) -> Take:
    if arguments.at is not None and arguments.punch_in is None:
        raise FacemimeError("--at needs another take to insert. Add --punch-in.")
    if arguments.cutoff and arguments.smooth != "zero-phase":
        raise FacemimeError("--cutoff is for smoothing without delay. Add --smooth zero-phase.")
    if arguments.punch_in is not None:
        insert = load_with_warnings(arguments.punch_in)
        start, end = parse_span(arguments.at or ":", (float(insert.times[0]), float(insert.times[-1])))
        take = punch_in(take, insert, start, end, arguments.blend)
    gaps = "bridge" if arguments.bridge else "hold" if arguments.hold else "leave"
    cutoffs = parse_cutoffs(arguments.cutoff)
    smoothing, mirror, neutral = arguments.smooth, arguments.mirror, arguments.neutral
    take = mend(take, Mending(arguments.outliers, gaps, arguments.longest, smoothing, cutoffs, mirror, neutral))
    if arguments.trim is not None:
        take = trim(take, *parse_span(arguments.trim))
    if arguments.shift:
        take = shift_time(take, arguments.shift)
    if arguments.rate is not None:
        take = resample(take, arguments.rate)
    return anonymise(take) if arguments.anonymous else take


def run_export(arguments: argparse.Namespace) -> int:
    """Run `facemime export`: write a take as a table."""
    with outputs_of(((arguments.output, {".csv"}),), {"the take that is exported": arguments.take}):
        take = load_with_warnings(arguments.take)
        if arguments.columns == "all":
            to_csv(take, arguments.output)
        else:
            _export_coefficients(take, arguments)
    return 0


def _export_coefficients(take: Take, arguments: argparse.Namespace) -> None:
    if not 1.0 <= arguments.rate <= 200.0:
        raise FacemimeError(f"The rate of a timecode cannot be {arguments.rate:g}. Use one between 1 and 200.")
    neutral = calibrate(take)
    if neutral.warning:
        tell(f"facemime: {neutral.warning}")
    seen = take.part(take.found)
    values = arkit_coefficients(seen, neutral)
    turns = np.array([turned_from(seen.result(frame), neutral) for frame in range(len(seen))])
    live_link = arguments.columns == "livelink"
    write_coefficient_csv(arguments.output, seen.times, values, turns, live_link=live_link, rate=arguments.rate)


def run_import(arguments: argparse.Namespace) -> int:
    """Run `facemime import`: write a table, or the motion of a face in an animation, as a take."""
    source = arguments.source
    is_table = source.path.suffix.lower() == ".csv"
    described = "the table that is imported" if is_table else "the animation that is imported"
    with outputs_of(((arguments.output, {SUFFIX}),), {described: source.path}):
        check_readable(source.path)
        save_take(from_any_csv(source.path) if is_table else _sampled(source), arguments.output)
    return 0


def _sampled(animation: HeadFile) -> Take:
    try:
        with STOPPING.importing():
            from .puppet.character import sample
    except ImportError as error:
        raise FacemimeError(
            f"An animation needs Blender ({error}). Run: blender --command facemime import ..., or install bpy."
        ) from error
    return sample(animation)


def parse_span(text: str, default: tuple[float, float] = (float("-inf"), float("inf"))) -> tuple[float, float]:
    """Parse a span `A:B` in seconds, either end of which may be omitted.

    Raises
    ------
    FacemimeError
        If it is not a span, or is empty.
    """
    first, colon, last = text.partition(":")
    try:
        start, end = float(first) if first else default[0], float(last) if last else default[1]
    except ValueError:
        colon = ""
    if not colon or not start < end:
        raise FacemimeError(f"{text!r} is not a time span. Use seconds, as in 1.5:4, 1.5: or :4.")
    return start, end


def parse_cutoffs(text: str) -> dict[str, float]:
    """Parse cutoffs in Hz by part, as in `mouth=6,jaw=4`; FacemimeError if it is anything else."""
    cutoffs = {}
    for item in filter(None, text.split(",")):
        part, _, value = item.partition("=")
        try:
            cutoffs[part.strip()] = float(value)
        except ValueError:
            raise FacemimeError(f"{item!r} is not a cutoff. Use the form mouth=6,jaw=4.") from None
    return cutoffs
