"""Options that several commands share, and the jobs that they describe."""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, get_type_hints

from ..core.bake.bake_settings import AUTOMATIC, BakeSettings
from ..core.drive.drive_settings import DriveSettings, PosingSettings
from ..core.errors import FacemimeError, Message, SourceError
from ..core.files.reading import shown
from ..core.files.setting import Setting, changed, settings_of
from ..core.puppet.job import CHARACTER_SUFFIXES, HeadFile, PuppetJob
from ..core.puppet.presets import COMMAND_NAMES, built_in_path, read_preset
from ..core.puppet.puppet_settings import PuppetSettings
from ..core.tracking.identity import LEFTMOST, RIGHTMOST
from ..core.tracking.tracker import TrackingSettings
from .console import printable, say, write_error

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

_SIDES = {"left": LEFTMOST, "right": RIGHTMOST}
_FOLLOWED = ("rotation", "translation")
_POSES = {"none": (False, False), "rotation": (True, False), "full": (True, True)}
"""Values of these settings by --pose."""
_MAX_COUNT = 1_000_000_000
_HEAD_FILE = re.compile(rf"(.+(?:{'|'.join(map(re.escape, CHARACTER_SUFFIXES))})):(.+)", re.IGNORECASE | re.DOTALL)
"""A file and the name of an object in it."""
_MAX_PIXEL = 1_000_000


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"  # argparse has no public name for it
Options = Mapping[str, Any]
"""Values of a command's options by name."""
Job = TypeVar("Job")


class Parser(argparse.ArgumentParser):
    """A parser whose messages cannot control the terminal, and whose streams may be closed."""

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        text = "\n".join(printable(line) for line in message.rstrip("\n").split("\n"))
        if file is sys.stdout:
            say(text)
        else:
            write_error(text + "\n")


def whole_number(text: str) -> int:
    """Type of options that count something."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(Message("{text} is not a whole number", text=_shortened(text))) from None
    if abs(value) > _MAX_COUNT:
        raise argparse.ArgumentTypeError(Message("{text} is too large", text=_shortened(text)))
    return value


def share_of_clips(text: str) -> tuple[int, int]:
    """Type of an option for a part of the clips: its number, and how many parts there are."""
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise argparse.ArgumentTypeError(Message("{text} is not a share, such as 3/20", text=_shortened(text)))
    return int(found[1]), int(found[2])


def number(text: str) -> float:
    """Type of options that measure something."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(Message("{text} is not a valid number", text=_shortened(text)))
    return value


def _shortened(text: str) -> str:
    return repr(text if len(text) <= 20 else f"{text[:17]}...")


def add_command(commands: Commands, name: str, summary: str) -> argparse.ArgumentParser:
    """Add a command, whose `summary`, in lower case, is shown in the list of commands and in its own help."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=f"{summary[0].upper()}{summary[1:]}."
    )
    return parser


def add_output(parser: argparse.ArgumentParser, metavar: str, summary: str) -> None:
    """Add the option for the output, which is required; `summary` says what is written."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=summary)


def add_face_option(group: argparse._ActionsContainer) -> None:
    """Add the option for the face to track if several are in view."""
    group.add_argument(
        "--face",
        type=face_of,
        metavar="left|right|X,Y",
        help="face to track if several are in view: the leftmost, the rightmost, or the nearest "
        "to a pixel of the first frame (the largest)",
    )


def add_neutral_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the time of the neutral face in a take."""
    parser.add_argument(
        "--neutral",
        type=number,
        metavar="SECONDS",
        help="start of a second in which the face is neutral (detected or estimated)",
    )


def add_key_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for the shared key of Facemime's own protocol."""
    parser.add_argument("--key", type=Path, metavar="FILE", help="shared key, for Facemime's own protocol")


def face_of(text: str) -> tuple[float, float] | None:
    """Parse `--face` into a position, as for `FaceTracker.choose`; None for the largest face.

    Raises FacemimeError if it is not a face.
    """
    if not text:
        return None
    if text in _SIDES:
        return _SIDES[text]
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        x = y = _MAX_PIXEL + 1
    if max(abs(x), abs(y)) > _MAX_PIXEL:
        raise FacemimeError("{text} is not a face. Use left, right, or pixels such as 320,240.", text=_shortened(text))
    return float(x), float(y)


def add_puppet_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `puppet_job` reads: the face, the head, how it moves, and what it is baked to."""
    add_face_option(parser)
    add_settings(parser, TrackingSettings)
    parser.add_argument(
        "--head", type=head_file, metavar="FILE[:OBJECT]", help="your own head, as for bind (the built-in head)"
    )
    parser.add_argument("--points", type=_path, metavar="POINTS.json", help="control points, from select")
    parser.add_argument(
        "--style", type=_path, metavar="FILE.facestyle", help="examples by which the head is corrected, from Save Style"
    )
    how = parser.add_argument_group("motion of the head")
    how.add_argument(
        "--pose", choices=tuple(_POSES), default="rotation", help="how much of the head's pose to follow (rotation)"
    )
    for group in (PuppetSettings, DriveSettings, PosingSettings):
        add_settings(how, group, without=_FOLLOWED)
    bake = parser.add_argument_group("baking")
    add_settings(bake, BakeSettings)
    bake.add_argument(
        "--map",
        type=_path,
        metavar="TABLE.json",
        help="key mapping for --keys mapped (the preset that matches the head best)",
    )


class _ReadPreset(argparse.Action):
    """Makes the settings of a preset the defaults of the other options, for the parser's next pass."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        """Read the preset; raises SourceError if that is not possible."""
        setattr(namespace, self.dest, values)
        options = {action.dest for action in parser._actions}
        chosen = read_preset(_preset_path(values))
        for group in chosen.values():
            parser.set_defaults(**{name: value for name, value in group.items() if name in options})


def _preset_path(text: str) -> Path:
    if text in COMMAND_NAMES:
        return built_in_path(COMMAND_NAMES[text])
    if not Path(text).is_file():
        raise SourceError(
            "There is no preset {text}. Use {known}, or a file.", text=shown(text), known=", ".join(COMMAND_NAMES)
        )
    return Path(text)


def add_preset_option(parser: argparse.ArgumentParser) -> None:
    """Add the option for a preset, which is read by `parse`."""
    names = ", ".join(COMMAND_NAMES)
    parser.add_argument(
        "--preset",
        action=_ReadPreset,
        metavar="NAME|FILE.json",
        help=f"settings that other options override: {names}, or a preset exported from Blender",
    )


def parse(parser: argparse.ArgumentParser, line: Sequence[str] | None) -> Options:
    """Parse a command line, then again with the defaults of its preset; raises SourceError if that is unreadable."""
    options = vars(parser.parse_args(line))
    return options if options.get("preset") is None else vars(parser.parse_args(line))


def filled(job: type[Job], options: Options, **more: Any) -> Job:
    """Create a dataclass, and those in its fields, from the options that have the names of its fields, and from `more`.

    Options that name no field are left out, and a field without an option has its default.
    """
    kinds = get_type_hints(job)
    values: dict[str, Any] = {}
    for field in dataclasses.fields(job):  # type: ignore[arg-type]
        if dataclasses.is_dataclass(kind := kinds[field.name]):
            values[field.name] = filled(kind, options)  # type: ignore[arg-type]
        elif field.name in options:
            values[field.name] = options[field.name]
    return job(**values | more)


def add_settings(
    parser: argparse.ArgumentParser | argparse._ArgumentGroup,
    group: type,
    without: Collection[str] = (),
    omitted: Mapping[str, str] | None = None,
) -> None:
    """Add an option for each setting of a group, named after its field, except those in `without`.

    `omitted` are the numbers whose option is None if it is omitted, with what their help says instead of a default.
    """
    for name, setting in settings_of(group).items():
        if name in without:
            continue
        summary = f"{setting.description[0].lower()}{setting.description[1:]}"
        if setting.kind is bool:
            parser.add_argument(
                _flag(name), action=argparse.BooleanOptionalAction, default=setting.default, help=summary
            )
            continue
        default, told = setting.default, _shown(setting, setting.default)
        if omitted is not None and name in omitted:
            default, told = None, omitted[name]
        if setting.unit == "file":
            parser.add_argument(_flag(name), type=_absolute, default=default, metavar="FILE", help=summary)
            continue
        more = {"choices": setting.values} if setting.choices else {"metavar": _METAVARS[setting.unit]}
        parser.add_argument(_flag(name), type=_type_of(setting), default=default, help=f"{summary} ({told})", **more)


def _type_of(setting: Setting) -> Callable[[str], Any]:
    """The type of an option, which rejects values that its setting cannot have."""

    def read(text: str) -> Any:
        value = whole_number(text) if setting.kind is int else number(text) / _scale(setting)
        try:
            return setting.checked(value, "the value")
        except ValueError:
            low, high = (_shown(setting, end) for end in (setting.low, setting.high))
            raise argparse.ArgumentTypeError(
                Message("{text} is not between {low} and {high}", text=_shortened(text), low=low, high=high)
            ) from None

    return str if setting.kind is str else read


_METAVARS = {"": "N", "percent": "PERCENT", "angle": "DEGREES", "seconds": "SECONDS"}


def _scale(setting: Setting) -> float:
    return 180.0 / math.pi if setting.unit == "angle" else setting.scale


def _shown(setting: Setting, value: Any) -> str:
    """The value of a setting as an option: angles in degrees, fractions in percent."""
    return str(value) if setting.kind in (str, int) else f"{value * _scale(setting):.12g}"


def puppet_job(options: Options, **more: Any) -> PuppetJob:
    """Create the job that the options of `add_puppet_options` describe, with `more` fields that have no option.

    Raises FacemimeError if options contradict each other.
    """
    given = {**options, **dict(zip(_FOLLOWED, _POSES[options["pose"]], strict=True))}
    if given["map"] is not None and given["keys"] == AUTOMATIC:
        given["keys"] = "mapped"
    elif given["map"] is not None and given["keys"] != "mapped":
        raise FacemimeError("--map is used with --keys mapped only. Add --keys mapped, or remove --map.")
    if given["positive"] is None:  # many programs that read glTF cut off values below 0
        given["positive"] = given.get("gltf") is not None
    return filled(PuppetJob, given, **more)


def as_options(job: PuppetJob) -> list[str]:
    """The options that describe the head, settings and bake of a job, with absolute paths."""
    line: list[str] = []
    if job.face is not None:
        sides = {place: name for name, place in _SIDES.items()}
        line += ["--face", sides.get(job.face) or ",".join(f"{part:.0f}" for part in job.face)]
    if job.head is not None:
        head = os.path.abspath(job.head.path)
        line += ["--head", f"{head}:{job.head.name}" if job.head.name else head]
    for name, path in (("points", job.points), ("map", job.map), ("style", job.style)):
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


def _absolute(text: str) -> str:
    return os.path.abspath(text) if text else ""


def _path(text: str) -> Path | None:
    return Path(text) if text else None


def head_file(text: str) -> HeadFile | None:
    """Parse FILE[:OBJECT]; None if it is empty."""
    if not text:
        return None
    named = _HEAD_FILE.fullmatch(text)
    return HeadFile(Path(named[1]), named[2]) if named else HeadFile(Path(text))
