"""The command `bind`: prepare a character as a head, and say what was made of its parts."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

from ..core.bake.key_sets import KEY_SETS
from ..core.errors import FacemimeError
from ..core.heads.bind import MARKS, MIN_MARKS
from ..core.puppet.job import CHARACTER_SUFFIXES
from ..core.takes.file import load_take
from .console import for_terminal, say, tell
from .job_files import importing_blender, outputs_of
from .options import Commands, Options, add_command, add_output, head_file

DOUBTFUL = 3
"""Exit status of `bind` if the head was written, but its face may be elsewhere."""


def add_commands(commands: Commands) -> None:
    """Add the command to the parser."""
    bind = add_command(commands, "bind", "prepare a character as a head: landmarks, regions, parts and bones")
    bind.add_argument(
        "character",
        type=head_file,
        metavar="FILE[:OBJECT]",
        help=f"a {', '.join(CHARACTER_SUFFIXES[:-1])} or {CHARACTER_SUFFIXES[-1]} file, and any mesh of the character "
        "(the most likely face)",
    )
    add_output(bind, "OUT.blend", "the file with the head, for puppet --head")
    bind.add_argument("--picture", type=Path, metavar="OUT.png", help="also write a picture of the face with landmarks")
    bind.add_argument(
        "--make-keys",
        nargs="?",
        choices=tuple(KEY_SETS),
        const="arkit",
        help="also add a set of shape keys: ARKit's 52 face units (without a name), VRM's, Oculus' or FaceGen's",
    )
    bind.add_argument(
        "--refine",
        type=Path,
        action="append",
        default=[],
        metavar="TAKE",
        help="a take whose motion ARKit's keys shall reproduce; may be repeated",
    )
    bind.add_argument(
        "--learn-controls",
        action="store_true",
        help="also learn what the controls of the character's own rig do to its face, for puppet --keys controls",
    )
    bind.add_argument(
        "--cut-open",
        action="store_true",
        help="cut open lips and eyes that are joined, as on a scan, and add a dark mouth",
    )
    points = "; ".join(f"{number} {name.lower()}" for number, name in sorted(MARKS.items()))
    bind.add_argument(
        "--mark",
        type=parse_mark,
        action="append",
        default=[],
        metavar="POINT=VERTEX|X,Y,Z",
        help=f"a point of the face, by vertex or by position in Blender; at least {MIN_MARKS} of: {points}",
    )
    bind.set_defaults(run=_run_bind)


def _run_bind(given: Options) -> int:
    """Run `facemime bind`: bind a character, and print a line for each part and key; returns the exit status.

    It is `DOUBTFUL` if the face may not be where it was found.
    """
    output, picture, make_keys = given["output"], given["picture"], given["make_keys"]
    if given["refine"] and make_keys != "arkit":
        raise FacemimeError("Takes refine ARKit's keys alone. Add --make-keys arkit, or leave out --refine.")
    takes = [load_take(path) for path in given["refine"]]
    with importing_blender("bind", "bind ..."):
        from . import character as headless
    with outputs_of(((output, {".blend"}), (picture, {".png"})), {"the character": given["character"].path}):
        keys = None if make_keys is None else KEY_SETS[make_keys]
        bound = headless.bind(
            given["character"],
            keys=keys,
            takes=takes,
            cut_open=given["cut_open"],
            marks=dict(given["mark"]),
            controls=given["learn_controls"],
        )
        headless.save(bound, output)
        if picture is not None:
            headless.write_picture(bound, picture)
    say(bound.table())
    if bound.keys is not None:
        say(bound.key_table())
    if bound.controls is not None:
        say(bound.control_table())
    for problem in bound.problems:
        tell(f"facemime: {for_terminal(problem)}")
    if doubt := bound.doubt():
        tell(f"facemime: {doubt}")
        return DOUBTFUL
    return 0


def parse_mark(text: str) -> tuple[int, int | tuple[float, float, float]]:
    """Parse a point of the face, `8=1234` or `8=0.1,0.02,1.6`; raises FacemimeError if it is anything else."""
    number, _, place = text.partition("=")
    values = place.split(",")
    with contextlib.suppress(ValueError):
        if (point := int(number)) in MARKS and len(values) == 1:
            return point, int(place)
        x, y, z = map(float, values)
        if point in MARKS and all(map(math.isfinite, (x, y, z))):
            return point, (x, y, z)
    known = ", ".join(map(str, sorted(MARKS)))
    raise FacemimeError(
        "{text!r} is not a point of a face. Use 8=VERTEX or 8=X,Y,Z, with one of: {known}.", text=text, known=known
    )
