"""The command `facemime`, which does what the operators do without Blender's window.

`bind`, `puppet`, `clip` and `batch` need `bpy`: either the module, or Blender itself, as in `blender --command facemime
puppet ...`. The other commands run without it.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence

from ..core.errors import FacemimeError
from ..core.files.assets import version
from ..core.puppet.job import HeadFile
from . import batch, bind, landmarks, live, receive, select, takes
from . import puppet as puppeting
from .console import for_terminal, tell
from .guard import is_child, run_in_child
from .options import Parser, parse
from .stopping import INTERRUPTED, STOPPING


def main(argv: Sequence[str] | None = None, *, guard: bool = False) -> int:
    """Run the command, and return the exit status.

    The status is 0, 1 for an error with a message, 2 for a wrong command line, 130 for Ctrl-C, 143 for SIGTERM. If
    `guard` is set, files of characters, which may be damaged, are read in a child process that may die.
    """
    with contextlib.ExitStack() as stack:
        if sys.stderr is None:  # closed by the caller
            stack.enter_context(contextlib.redirect_stderr(stack.enter_context(open(os.devnull, "w"))))
        try:
            options = parse(_parser(), argv)
            file = next((value for value in options.values() if isinstance(value, HeadFile)), None)
            if guard and not is_child() and file is not None and file.is_character:
                status = run_in_child(sys.argv[1:] if argv is None else argv, file.path)
            else:
                status = int(options["run"](options))
        except FacemimeError as error:
            tell(f"facemime: {for_terminal(str(error))}")
            return 1
        except KeyboardInterrupt as stop:
            kept = f"; {stop}" if str(stop) else ". Files that were complete are kept"
            tell(f"facemime: interrupted{kept}.")
            status = INTERRUPTED
        return STOPPING.status if status == INTERRUPTED else status


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="facemime", description="Live face puppetry for Blender.")
    parser.add_argument("--version", action="version", version=f"facemime {version()}")
    commands = parser.add_subparsers(dest="command", required=True)

    for module in (landmarks, bind, puppeting, select, takes):
        module.add_commands(commands)
    live.add_send(commands)
    receive.add_commands(commands)
    live.add_serve(commands)
    batch.add_commands(commands)
    return parser
