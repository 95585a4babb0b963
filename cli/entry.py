"""Where the command's own process starts and ends.

`main` is for whoever has a process already: tests, and Blender.
"""

from __future__ import annotations

import os
import sys
from typing import NoReturn

from ..batch.leash import follow_stdin
from .stopping import STOPPING, open_standard_streams


def start() -> NoReturn:
    """Run the command line of this process and end it with the exit status."""
    STOPPING.install()
    open_standard_streams()
    follow_stdin()
    from .main import main

    STOPPING.run()
    try:
        status = main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        status = STOPPING.status
    except Exception:
        sys.excepthook(*sys.exc_info())
        status = 1
    _leave(status)


def _leave(status: int) -> NoReturn:
    STOPPING.leave()
    for name in ("stdout", "stderr"):
        try:
            getattr(sys, name).flush()
        except OSError:  # nobody reads; Python would complain of it once more at its end
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - for what is left of the process
    if "bpy" not in sys.modules:
        sys.exit(status)
    _leave_blender(status)


def _leave_blender(status: int) -> NoReturn:
    """End without Blender's own clean-up, which waits for ever where a scene holds a driver that it did not run."""
    import shutil

    import bpy

    folder = os.path.normpath(bpy.app.tempdir) if bpy.app.tempdir else ""
    if os.path.basename(folder).startswith("blender_"):  # else it is the user's folder for all temporary files
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(status)
