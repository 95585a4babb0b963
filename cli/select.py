"""The command `select`: choose the control points that a take needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.base.landmarks import IBUG68_INDICES
from ..core.base.setting import settings_of
from ..core.base.writing import replacing
from ..core.drive.drive_settings import DriveSettings
from ..core.drive.greedy import GreedySelection
from ..core.drive.select import parse_landmarks, select_control_points, to_json
from ..core.drive.selection_settings import SelectionSettings
from ..core.heads.regions import REGIONS
from ..core.heads.rig import HeadRig, built_in_head
from ..core.puppet.job import HeadFile
from ..core.takes.neutral import calibrate
from .console import say, tell
from .job_files import importing_blender, load_with_warnings, outputs_of
from .options import Commands, add_command, add_neutral_option, add_preset_option, add_settings, filled, head_file


@dataclass(frozen=True)
class _SelectJob:
    """Control points to select.

    Attributes
    ----------
    take : Path
    output : Path or None
        File for the control points.
    head : HeadFile or None
        The head; None for the built-in one.
    settings : SelectionSettings
    kernel : str or None
        Kernel that the points are meant for; None for that of the search.
    add, remove : sequence of int
        Landmarks that are always, and never, control points.
    neutral : float or None
        Start of the second with the neutral face, seconds; None detects it.
    """

    take: Path
    output: Path | None
    head: HeadFile | None
    settings: SelectionSettings
    kernel: str | None
    add: Sequence[int]
    remove: Sequence[int]
    neutral: float | None


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
    select.set_defaults(run=lambda given: _run_select(filled(_SelectJob, given)))


def _run_select(job: _SelectJob) -> int:
    """Run `facemime select`: choose control points, and print a line per step; returns the exit status."""
    inputs = {"the take that is read": job.take, "the file of the head": None if job.head is None else job.head.path}
    with outputs_of(((job.output, {".json"}),), inputs):
        take = load_with_warnings(job.take)
        selection = select_control_points(
            built_in_head() if job.head is None else _rig_of(job.head),
            take,
            neutral=calibrate(take, job.neutral),
            tolerance=job.settings.tolerance,
            max_points=job.settings.max_points,
            always=job.add,
            never=job.remove,
            search=job.settings.search,
            kernel=job.kernel,
        )
        if job.output is not None:
            with replacing(job.output) as temporary:
                temporary.write_text(to_json(selection) + "\n", encoding="utf-8")
    say(_table(selection))
    if not selection.reached:
        tell("facemime: the tolerance was not reached. Raise --max-points or --tolerance.")
    return 0


def _rig_of(head: HeadFile) -> HeadRig:
    """Return the rig of a head in a file.

    Raises
    ------
    FacemimeError
        If Blender is missing, or the file has no head and no face.
    """
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
