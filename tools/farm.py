"""Write the templates for render farms from the options that every clip of a batch has.

Usage: python tools/farm.py; writes farm/facemime.openjd.yaml and farm/facemime.js.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

from facemime.cli.terminal.options import Parser, add_puppet_options

FARM = Path(__file__).resolve().parents[1] / "farm"


@dataclass(frozen=True)
class Option:
    """An option of the command line as a farm's parameter.

    Attributes
    ----------
    name : str
        Without dashes: max-keys.
    default : str, float, int or bool
    choices : tuple of str
        Empty where it is not one of several.
    description : str
    """

    name: str
    default: str | float | int | bool
    choices: tuple[str, ...]
    description: str

    @property
    def key(self) -> str:
        """As Flamenco names it: max_keys."""
        return self.name.replace("-", "_")

    @property
    def title(self) -> str:
        """As Open Job Description names it: MaxKeys."""
        return "".join(part.capitalize() for part in self.name.split("-"))


def options() -> list[Option]:
    """The options that `facemime clip` and `facemime batch` have in common."""
    parser = Parser(add_help=False)
    add_puppet_options(parser)
    return [_option(action) for action in parser._actions]


def _option(action: argparse.Action) -> Option:
    name = action.option_strings[0].removeprefix("--")
    help_text = str(action.help)
    default: str | float | int | bool = "" if action.default is None else action.default
    if isinstance(default, float):  # as the option has it: in degrees, or in percent
        default = float(help_text.rpartition("(")[2].rstrip(")"))
    return Option(name, default, tuple(action.choices or ()), help_text)


def openjd() -> str:
    """The template for Open Job Description."""
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
    return _OPENJD.format(parameters="\n".join(parameters), arguments="\n".join(arguments))


def flamenco() -> str:
    """The job type for Flamenco."""
    settings, switches = [], []
    for option in options():
        kind = {str: "string", int: "int32", float: "float", bool: "bool"}[type(option.default)]
        choices = f" choices: {json.dumps(option.choices)}," if option.choices else ""
        settings.append(
            f'        {{ key: "{option.key}", type: "{kind}",{choices} default: {json.dumps(option.default)},\n'
            f"          description: {json.dumps(option.description)} }},"
        )
        switches.append(f'    "{option.name}",')
    return _FLAMENCO.replace("@SETTINGS@", "\n".join(settings)).replace("@OPTIONS@", "\n".join(switches))


_OPENJD = """# Open Job Description: the clips of a folder or a list, one task each, then a report of all.
# Made by tools/farm.py. The hosts need `facemime` on their path. Run again, it skips clips that are done.
specificationVersion: jobtemplate-2023-09
name: Facemime
parameterDefinitions:
  - name: Clips
    type: STRING
    description: Folder of clips, or a text file with one path per line
  - name: Count
    type: INT
    minValue: 1
    description: Number of clips
  - name: Output
    type: STRING
    description: Folder for the results
{parameters}
steps:
  - name: Clip
    parameterSpace:
      taskParameterDefinitions:
        - name: Number
          type: INT
          range: "1-{{{{Param.Count}}}}"
    script:
      actions:
        onRun:
          command: facemime
          args:
            - clip
            - "{{{{Param.Clips}}}}"
            - "--number"
            - "{{{{Task.Param.Number}}}}"
            - "-o"
            - "{{{{Param.Output}}}}"
{arguments}
  - name: Report
    dependencies:
      - dependsOn: Clip
    script:
      actions:
        onRun:
          command: facemime
          args:
            - batch
            - "{{{{Param.Clips}}}}"
            - "-o"
            - "{{{{Param.Output}}}}"
{arguments}
"""
_FLAMENCO = """/* Flamenco job type: the clips of a folder or a list, one task each, then a report of all.
 * Made by tools/farm.py. Goes into the `scripts` folder of the Flamenco manager. The workers need `facemime` on their
 * path, and must see the clips, the head and the output folder under the same paths. Run again, it skips clips that are
 * done. */
const JOB_TYPE = {
    label: "Facemime",
    description: "Move a head by the faces of many video clips",
    settings: [
        { key: "clips", type: "string", required: true,
          description: "Folder of clips, or a text file with one path per line" },
        { key: "count", type: "int32", required: true, description: "Number of clips" },
        { key: "output", type: "string", subtype: "dir_path", required: true, description: "Folder for the results" },
@SETTINGS@
    ],
};

const OPTIONS = [
@OPTIONS@
];

function compileJob(job) {
    const settings = job.settings;
    const options = ["-o", settings.output];
    for (const name of OPTIONS) {
        const value = settings[name.split("-").join("_")];
        if (value === true) options.push("--" + name);
        else if (value === false) options.push("--no-" + name);
        else if (value !== undefined && value !== "") options.push("--" + name, String(value));
    }
    const report = facemime("report", ["batch", settings.clips].concat(options));
    for (let number = 1; number <= settings.count; number++) {
        const task = facemime("clip-" + number, ["clip", settings.clips, "--number", String(number)].concat(options));
        report.addDependency(task);
        job.addTask(task);
    }
    job.addTask(report);
}

function facemime(name, args) {
    const task = author.Task(name, "misc");
    task.addCommand(author.Command("exec", { exe: "facemime", args: args }));
    return task;
}
"""


def main() -> int:
    """Write both; returns the exit status."""
    (FARM / "facemime.openjd.yaml").write_text(openjd(), encoding="utf-8")
    (FARM / "facemime.js").write_text(flamenco(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
