"""What several commands have in common: which head is moved, how, and what of it is animated."""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path
from typing import IO, Any

from ...core.deform.head_deformer import INFORMED
from ...core.errors import FacemimeError
from ...core.mesh.kernels import KERNELS
from ...core.tracking.tracker import LEFTMOST, RIGHTMOST
from .console import printable, say, write_error

_SIDES = {"left": LEFTMOST, "right": RIGHTMOST}
_PATHS = ("head", "points", "map")
_FLAGS = ("smooth", "nla")
_LARGEST = 1_000_000_000
_FURTHEST = 1_000_000
_NAMES = ("face", "head", "mode", "kernel", "points", "smooth", "pose", "keys", "max_keys", "clean", "map", "nla")


Commands = argparse._SubParsersAction  # argparse names the type of what add_subparsers gives in no other way


class Parser(argparse.ArgumentParser):
    """A parser whose messages cannot command a terminal, and may go where nobody reads."""

    def _print_message(self, message: str, file: IO[str] | None = None) -> None:
        text = "\n".join(printable(line) for line in message.rstrip("\n").split("\n"))
        if file is sys.stdout:
            say(text)
        else:
            write_error(text + "\n")


def whole_number(text: str) -> int:
    """The type of an option that counts something."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{_shortened(text)} is no whole number") from None
    if abs(value) > _LARGEST:
        raise argparse.ArgumentTypeError(f"{_shortened(text)} is too large")
    return value


def number(text: str) -> float:
    """The type of an option that measures something."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{_shortened(text)} is no number that can be used")
    return value


def _shortened(text: str) -> str:
    return repr(text if len(text) <= 20 else f"{text[:17]}...")


def add_command(commands: Commands, name: str, told: str) -> argparse.ArgumentParser:
    """A command that does what is `told`, in the list of all commands and at the top of its own help."""
    parser: argparse.ArgumentParser = commands.add_parser(name, help=told, description=f"{told[0].upper()}{told[1:]}.")
    return parser


def add_output(parser: argparse.ArgumentParser, metavar: str, told: str) -> None:
    """Where the result goes, which has to be said."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=told)


def add_face_option(parser: argparse.ArgumentParser) -> None:
    """Whom to follow where several people are in view."""
    parser.add_argument(
        "--face",
        metavar="left|right|X,Y",
        help="of several people the leftmost, the rightmost, or the one at these "
        "pixels of the first frame; the largest by default",
    )


def face_of(text: str | None) -> tuple[float, float] | None:
    """The place that `--face` names, as for `FaceTracker.choose`; None for the largest face.

    Raises
    ------
    FacemimeError
        Where it names none.
    """
    if not text:
        return None
    if text in _SIDES:
        return _SIDES[text]
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        x = y = _FURTHEST + 1
    if max(abs(x), abs(y)) > _FURTHEST:
        raise FacemimeError(f"{_shortened(text)} names no face. Give left, right, or pixels as 320,240.")
    return float(x), float(y)


def add_head_options(parser: argparse.ArgumentParser) -> None:
    """The options that say which head is moved, by whom and how; `puppet`, `clip` and `batch` have them in common."""
    add_face_option(parser)
    parser.add_argument("--head", metavar="FILE.blend[:OBJECT]", help="your own head; the built-in one by default")
    parser.add_argument("--mode", choices=("3d", "planar"), default="3d", help="planar keeps every depth (3d)")
    parser.add_argument(
        "--kernel", choices=(INFORMED, *KERNELS), default=INFORMED, help=f"how skin follows landmarks ({INFORMED})"
    )
    parser.add_argument("--points", type=_path, metavar="POINTS.json", help="control points that select chose")
    parser.add_argument("--smooth", action="store_true", help="hold still what does not move; a kept take stays raw")
    parser.add_argument(
        "--pose", choices=("rotation", "full", "none"), default="rotation", help="head pose to follow (rotation)"
    )


def add_bake_options(parser: argparse.ArgumentParser) -> None:
    """The options that say what is animated."""
    bake = parser.add_argument_group("what is animated")
    bake.add_argument(
        "--keys",
        choices=("new", "named", "mapped", "cache", "alembic"),
        default="new",
        help="new shape keys; the head's own, fitted to the motion or by a table; every vertex exactly, in a .pc2 or "
        "also .abc beside the output (new)",
    )
    bake.add_argument("--max-keys", type=whole_number, default=64, metavar="K", help="new keys at most (64)")
    bake.add_argument(
        "--clean",
        type=float,
        default=0.0,
        metavar="PERCENT",
        help="leave keyframes out: how far vertices may move by that, of the eye distance (0)",
    )
    bake.add_argument(
        "--map", type=_path, metavar="TABLE.json", help="for --keys mapped; else the preset that fits best"
    )
    bake.add_argument("--nla", action="store_true", help="put the animation onto NLA tracks")


def head_file(spec: str | None) -> tuple[Path | None, str]:
    """The file and the object, or no object, that `--head` names; no file where it is not given."""
    if spec is None:
        return None, ""
    file, found, name = spec.rpartition(".blend:")
    return (Path(file + ".blend"), name) if found else (Path(spec), "")


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def settings_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """The values of these options; one that is empty, as a farm's template gives it, is not given."""
    given = {name: getattr(arguments, name) for name in _NAMES}
    return {name: None if value is False or value == "" else value for name, value in given.items()}


def as_line(settings: dict[str, Any]) -> list[str]:
    """`settings_of` as they are given on a command line, with paths that hold in any folder."""
    line: list[str] = []
    for name, value in settings.items():
        if value is None:
            continue
        line.append(f"--{name.replace('_', '-')}")
        if name not in _FLAGS:
            line.append(os.path.abspath(value) if name in _PATHS else str(value))
    return line
