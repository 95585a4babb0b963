"""The command `select`: choose the control points that a take needs."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..core.control_points.greedy import GreedySelection
from ..core.control_points.select import parse_landmarks, select_for_take, to_json
from ..core.control_points.settings import SelectionSettings
from ..core.drive.settings import DriveSettings
from ..core.errors import FacemimeError
from ..core.files import replacing
from ..core.heads.regions import REGIONS
from ..core.heads.rig import HeadRig, built_in_rig
from ..core.landmarks import IBUG68_INDICES
from ..core.puppet.job import HeadFile
from ..core.settings import settings_of
from ..core.takes.neutral import calibrate
from .terminal.console import say, tell
from .terminal.options import Commands, add_command, add_preset_option, add_settings, head_file, number
from .terminal.outputs import outputs_of
from .terminal.stopping import STOPPING
from .terminal.takes import load_with_warnings


def add_commands(commands: Commands) -> None:
    """Add the command to the parser."""
    select = add_command(commands, "select", "choose the control points that a take needs on a head")
    select.add_argument("take", type=Path, metavar="TAKE.facetake", help="a take, from track")
    select.add_argument("-o", "--output", type=Path, metavar="POINTS.json", help="file for puppet --points")
    select.add_argument(
        "--head", type=head_file, metavar="FILE[:OBJECT]", help="your own head, as for bind (the built-in head)"
    )
    add_preset_option(select)
    add_settings(select, SelectionSettings)
    kernels = settings_of(DriveSettings)["kernel"].values
    select.add_argument("--kernel", choices=kernels, help="skinning that the points are meant for (that of the search)")
    select.add_argument("--add", default="", metavar="17,19-21", help="landmarks to include, by iBUG number")
    select.add_argument("--remove", default="", metavar="0-3,30", help="landmarks to exclude")
    select.add_argument(
        "--neutral",
        type=number,
        metavar="SECONDS",
        help="start of a second with a neutral face (found or estimated)",
    )
    select.set_defaults(run=run_select)


def run_select(arguments: argparse.Namespace) -> int:
    """Run `facemime select`: choose control points, and print a line per step."""
    always, never = parse_landmarks(arguments.add), parse_landmarks(arguments.remove)
    with outputs_of(((arguments.output, {".json"}),), _inputs(arguments)):
        take = load_with_warnings(arguments.take)
        selection = select_for_take(
            built_in_rig() if arguments.head is None else _rig_of(arguments.head),
            take,
            neutral=calibrate(take, arguments.neutral),
            tolerance=arguments.tolerance,
            max_points=arguments.max_points,
            always=always,
            never=never,
            search=arguments.search,
            kernel=arguments.kernel,
        )
        if arguments.output is not None:
            with replacing(arguments.output) as temporary:
                temporary.write_text(to_json(selection) + "\n", encoding="utf-8")
    say(_table(selection))
    if not selection.reached:
        tell("facemime: the tolerance was not reached. Raise --max-points or --tolerance.")
    return 0


def _inputs(arguments: argparse.Namespace) -> dict[str, Path | None]:
    head = None if arguments.head is None else arguments.head.path
    return {"the take that is read": arguments.take, "the file of the head": head}


def _rig_of(head: HeadFile) -> HeadRig:
    """Return the rig of a head in a file.

    Raises
    ------
    FacemimeError
        If Blender is missing, or the file has no head and no face.
    """
    try:
        with STOPPING.importing():
            from ..blender.rigs import read_rig
            from .puppet.files import open_head
    except ImportError as error:
        raise FacemimeError(
            f"select --head needs Blender ({error}). Run: blender --command facemime select ..., or install bpy."
        ) from error
    return read_rig(open_head(head))


def _table(selection: GreedySelection) -> str:
    """A line per step, and one with the control points."""
    lines = ["action  landmark  region  points  worst error %  in frame  at landmark  reason"]
    for step in selection.steps:
        landmark, worst = IBUG68_INDICES[[step.landmark, step.worst]]
        lines.append(
            f"{step.action:6}  {landmark:8}  {REGIONS[step.region].name:6}  {step.points:6}  {100 * step.error:13.2f}  "
            f"{step.frame:8}  {worst:11}  {step.reason}"
        )
    chosen = ", ".join(str(number) for number in IBUG68_INDICES[selection.landmarks])
    return "\n".join([*lines, f"{len(selection.landmarks)} control points: {chosen}"])
