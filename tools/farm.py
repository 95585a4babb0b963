"""Write the options of a clip into the templates for render farms, between their marks.

Usage: python tools/farm.py; changes farm/facemime.openjd.yaml and farm/facemime.js.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from facemime.cli.options import Parser, add_puppet_options

FARM = Path(__file__).resolve().parents[1] / "farm"
_BLOCK = re.compile(
    r"^( *(?://|#) Options, written by tools/farm.py\n)(?:.*\n)*?( *(?://|#) End of options\n)", re.MULTILINE
)
"""The text between the marks is replaced."""


@dataclass(frozen=True)
class Option:
    """An option of the command line as a parameter of a render farm.

    Attributes
    ----------
    name : str
        Name without leading dashes, such as "max-keys".
    default : str, float, int or bool
    choices : tuple of str
        Allowed values of an enumeration, otherwise empty.
    description : str
    """

    name: str
    default: str | float | int | bool
    choices: tuple[str, ...]
    description: str

    @property
    def key(self) -> str:
        """Name in Flamenco, such as "max_keys"."""
        return self.name.replace("-", "_")

    @property
    def title(self) -> str:
        """Name in Open Job Description, such as "MaxKeys"."""
        return "".join(part.capitalize() for part in self.name.split("-"))


def options() -> list[Option]:
    """Return the options that `facemime clip` and `facemime batch` share."""
    parser = Parser(add_help=False)
    add_puppet_options(parser)
    return [_option(action) for action in parser._actions]


def _option(action: argparse.Action) -> Option:
    name = action.option_strings[0].removeprefix("--")
    help_text = str(action.help)
    default: str | float | int | bool = "" if action.default is None else action.default
    if isinstance(default, float):  # as on the command line: degrees, or per cent
        default = float(help_text.rpartition("(")[2].rstrip(")"))
    return Option(name, default, tuple(action.choices or ()), help_text)


def openjd() -> str:
    """Return the template for Open Job Description."""
    parameters, arguments = [], []
    for option in options():
        lines = [f"  - name: {option.title}"]
        value = "{{Param." + option.title + "}}"
        if isinstance(option.default, bool):
            on, off = f"--{option.name}", f"--no-{option.name}"
            lines += ["    type: STRING", f'    default: "{on if option.default else off}"']
            lines += [f'    allowedValues: ["{on}", "{off}"]']
            arguments.append(f'            - "{value}"')
        else:
            kind = {str: "STRING", int: "INT", float: "FLOAT"}[type(option.default)]
            lines += [f"    type: {kind}", f"    default: {json.dumps(option.default)}"]
            if option.choices:
                lines.append(f"    allowedValues: {json.dumps(option.choices)}")
            arguments += [f'            - "--{option.name}"', f'            - "{value}"']
        lines.append(f"    description: {json.dumps(option.description)}")
        parameters += lines
    return _filled("facemime.openjd.yaml", parameters, arguments, arguments)


def flamenco() -> str:
    """Return the job type for Flamenco."""
    settings, switches = [], []
    for option in options():
        kind = {str: "string", int: "int32", float: "float", bool: "bool"}[type(option.default)]
        choices = f" choices: {json.dumps(option.choices)}," if option.choices else ""
        settings.append(
            f'        {{ key: "{option.key}", type: "{kind}",{choices} default: {json.dumps(option.default)},\n'
            f"          description: {json.dumps(option.description)} }},"
        )
        switches.append(f'    "{option.name}",')
    return _filled("facemime.js", settings, switches)


def _filled(name: str, *blocks: Sequence[str]) -> str:
    """Return the text of a template with `blocks` of lines between its marks."""
    parts = _BLOCK.split((FARM / name).read_text(encoding="utf-8"))
    kept = [parts[0]]
    for lines, (first, last, rest) in zip(blocks, zip(*(parts[n::3] for n in (1, 2, 3)), strict=True), strict=True):
        kept += [first, *(f"{line}\n" for line in lines), last, rest]
    return "".join(kept)


def main() -> int:
    """Write both templates; return the exit status."""
    (FARM / "facemime.openjd.yaml").write_text(openjd(), encoding="utf-8")
    (FARM / "facemime.js").write_text(flamenco(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
