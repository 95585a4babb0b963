"""The command `select`: choose the control points that a take needs."""

from __future__ import annotations

from pathlib import Path

from ..core.control_points.select import parse_landmarks, select_control_points
from ..core.control_points.selection import GreedySelection, SelectionSettings, to_json
from ..core.drive.drive_settings import DriveSettings
from ..core.face.landmarks import IBUG68_INDICES
from ..core.files.setting import settings_of
from ..core.files.writing import replacing
from ..core.heads.regions import REGIONS
from ..core.heads.rig import HeadRig, built_in_head
from ..core.puppet.job import HeadFile
from ..core.takes.neutral import calibrate
from .console import say, tell
from .job_files import importing_blender, load_with_warnings, outputs_of
from .options import Commands, Options, add_command, add_neutral_option, add_preset_option, add_settings, head_file


def add_commands(commands: Commands) -> None:
    """Add the command to the parser."""
    select = add_command(commands, "select", "select control points on a head for a take")
    select.add_argument("take", type=Path, metavar="TAKE.facetake", help="a take, from track")
    select.add_argument("-o", "--output", type=Path, metavar="POINTS.json", help="file for puppet --points")
    select.add_argument(
        "--head", type=head_file, metavar="FILE[:OBJECT]", help="your own head, as for bind (the built-in head)"
    )
    add_preset_option(select)
    add_settings(select, SelectionSettings)
    kernels = settings_of(DriveSettings)["kernel"].values
    select.add_argument("--kernel", choices=kernels, help="skinning to select the points for (that of the search)")
    for option, example, text in (
        ("--add", "17,19-21", "landmarks to include, by iBUG number"),
        ("--remove", "0-3,30", "landmarks to exclude"),
    ):
        select.add_argument(option, type=parse_landmarks, default=(), metavar=example, help=text)
    add_neutral_option(select)
    select.set_defaults(run=_run_select)


def _run_select(given: Options) -> int:
    """Run `facemime select`: choose control points, and print a line per step; returns the exit status."""
    inputs = {
        "the take that is read": given["take"],
        "the file of the head": None if given["head"] is None else given["head"].path,
    }
    with outputs_of(((given["output"], {".json"}),), inputs):
        take = load_with_warnings(given["take"])
        selection = select_control_points(
            built_in_head() if given["head"] is None else _rig_of(given["head"]),
            take,
            neutral=calibrate(take, given["neutral"]),
            always=given["add"],
            never=given["remove"],
            **{name: given[name] for name in settings_of(SelectionSettings)},
            kernel=given["kernel"],
        )
        if given["output"] is not None:
            with replacing(given["output"]) as temporary:
                temporary.write_text(to_json(selection) + "\n", encoding="utf-8")
    say(_table(selection))
    if not selection.reached:
        tell("facemime: the tolerance was not reached. Raise --max-points or --tolerance.")
    return 0


def _rig_of(head: HeadFile) -> HeadRig:
    """Return the rig of a head in a file; raises FacemimeError if Blender is missing, or the file has no face."""
    with importing_blender("select --head", "select ..."):
        from ..blender.rigs import read_rig
        from .character_files import open_head
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
