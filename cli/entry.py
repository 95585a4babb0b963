"""Where the command's own process starts and ends.

`main` is for whoever goes on afterwards: tests, and programs that call Facemime.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from .terminal.stopping import STOPPING, open_standard_streams


def start(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line `arguments`, or else that of this process, and end the process with the exit status."""
    STOPPING.install()
    open_standard_streams()
    with STOPPING.starting():
        from .terminal.leash import follow_stdin

        follow_stdin()
        from .main import main
    STOPPING.run()
    try:
        status = main(arguments)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        status = STOPPING.status
    except Exception:
        sys.excepthook(*sys.exc_info())
        status = 1
    _leave(status)


def _leave(status: int) -> NoReturn:
    """End at once: Python's own end takes signals for its death, and Blender's waits for ever where a scene holds a
    driver that it did not run.
    """
    STOPPING.leave()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # nobody reads
            stream.flush()
    if "bpy" in sys.modules:
        _remove_blenders_folder()
    os._exit(status)


def _remove_blenders_folder() -> None:
    import shutil

    import bpy

    folder = os.path.normpath(bpy.app.tempdir) if bpy.app.tempdir else ""
    if os.path.basename(folder).startswith("blender_"):  # else it is the user's folder for all temporary files
        shutil.rmtree(folder, ignore_errors=True)
