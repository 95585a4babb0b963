"""What several commands have in common: which head is moved, how, and what of it is animated."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable, Collection
from pathlib import Path
from typing import IO, Any

from ...core.bake.settings import BakeSettings
from ...core.drive.settings import DriveSettings, PosingSettings
from ...core.errors import FacemimeError
from ...core.puppet.job import HeadFile, PuppetJob
from ...core.puppet.settings import PuppetSettings
from ...core.settings import Setting, changed, settings_of
from ...core.tracking.choice import LEFTMOST, RIGHTMOST
from .console import printable, say, write_error

_SIDES = {"left": LEFTMOST, "right": RIGHTMOST}
_FOLLOWED = ("rotation", "translation")
_POSES = {"none": (False, False), "rotation": (True, False), "full": (True, True)}
"""What --pose says of those."""
_LARGEST = 1_000_000_000
_FURTHEST = 1_000_000


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


def add_puppet_options(parser: argparse.ArgumentParser) -> None:
    """The options that say which head is moved, by whom, how, and to what it is baked; `puppet_job` reads them."""
    add_face_option(parser)
    parser.add_argument("--head", type=_head, metavar="FILE.blend[:OBJECT]", help="your own head (the built-in one)")
    parser.add_argument("--points", type=_path, metavar="POINTS.json", help="control points that select chose")
    how = parser.add_argument_group("how the head moves")
    how.add_argument("--pose", choices=tuple(_POSES), default="rotation", help="head pose to follow (rotation)")
    for group in (PuppetSettings, DriveSettings, PosingSettings):
        _add_settings(how, group, without=_FOLLOWED)
    bake = parser.add_argument_group("what it is baked to")
    _add_settings(bake, BakeSettings)
    bake.add_argument(
        "--map", type=_path, metavar="TABLE.json", help="for --keys mapped (the preset that fits the head best)"
    )


def _add_settings(parser: argparse._ArgumentGroup, group: type, without: Collection[str] = ()) -> None:
    """An option for each setting of a group, named as its field is."""
    for name, setting in settings_of(group).items():
        if name in without:
            continue
        told = f"{setting.description[0].lower()}{setting.description[1:]}"
        if setting.kind is bool:
            parser.add_argument(_flag(name), action=argparse.BooleanOptionalAction, default=setting.default, help=told)
            continue
        default = _shown(setting, setting.default)
        more = {"choices": setting.values} if setting.choices else {"metavar": _METAVARS[setting.unit]}
        parser.add_argument(
            _flag(name), type=_type_of(setting), default=setting.default, help=f"{told} ({default})", **more
        )


def _type_of(setting: Setting) -> Callable[[str], Any]:
    """What reads an option's value, and refuses one that the setting cannot have."""

    def read(text: str) -> Any:
        value = whole_number(text) if setting.kind is int else number(text) / _scale(setting)
        try:
            return setting.checked(value, "the value")
        except ValueError:
            low, high = (_shown(setting, end) for end in (setting.low, setting.high))
            raise argparse.ArgumentTypeError(f"{_shortened(text)} is not between {low} and {high}") from None

    return str if setting.kind is str else read


_METAVARS = {"": "N", "percent": "PERCENT", "angle": "DEGREES", "seconds": "SECONDS"}


def _scale(setting: Setting) -> float:
    return 180.0 / math.pi if setting.unit == "angle" else setting.scale


def _shown(setting: Setting, value: Any) -> str:
    """The value of a setting as an option has it: angles in degrees, fractions in percent."""
    return str(value) if setting.kind in (str, int) else f"{value * _scale(setting):.12g}"


def puppet_job(
    arguments: argparse.Namespace, source: Path, output: Path, neutral: float | None = None, **wanted: Path | None
) -> PuppetJob:
    """The job that the options of `add_puppet_options` describe; `wanted` are further outputs of `PuppetJob`.

    Raises
    ------
    FacemimeError
        Where they make no sense.
    """
    if arguments.map is not None and arguments.keys != "mapped":
        raise FacemimeError("A table is for keys that are mapped. Give --keys mapped, or no --map.")
    given = vars(arguments)

    def read(group: type, **more: Any) -> Any:
        return group(**{name: given[name] for name in settings_of(group) if name in given}, **more)

    settings = read(
        PuppetSettings,
        **dict(zip(_FOLLOWED, _POSES[arguments.pose], strict=True)),
        neutral=neutral,
        drive=read(DriveSettings, posing=read(PosingSettings)),
        bake=read(BakeSettings),
    )
    face = face_of(arguments.face)
    return PuppetJob(source, output, settings, face, arguments.head, arguments.points, arguments.map, **wanted)


def as_options(job: PuppetJob) -> list[str]:
    """The options that describe a job's head, settings and bake, with paths that hold in any folder."""
    line: list[str] = []
    if job.face is not None:
        sides = {place: name for name, place in _SIDES.items()}
        line += ["--face", sides.get(job.face) or ",".join(f"{part:.0f}" for part in job.face)]
    if job.head is not None:
        path = os.path.abspath(job.head.path)
        line += ["--head", f"{path}:{job.head.name}" if job.head.name else path]
    for name, path in (("points", job.points), ("map", job.map)):
        if path is not None:
            line += [_flag(name), os.path.abspath(path)]
    followed = tuple(getattr(job.settings, name) for name in _FOLLOWED)
    line += ["--pose", next(name for name, follows in _POSES.items() if follows == followed)]
    for name, setting, value in changed(job.settings):
        if name not in _FOLLOWED:
            line += [_switch(name, value)] if setting.kind is bool else [_flag(name), _shown(setting, value)]
    return line


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _switch(name: str, value: bool) -> str:
    return _flag(name) if value else f"--no-{name.replace('_', '-')}"


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def _head(text: str) -> HeadFile | None:
    if not text:
        return None
    file, found, name = text.rpartition(".blend:")
    return HeadFile(Path(file + ".blend"), name) if found else HeadFile(Path(text))
