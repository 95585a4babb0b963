"""Start and end of the command's process, on its own or within Blender, by `blender --command facemime ...`.

Tests and programs that call Facemime and continue afterwards use `main` instead.
"""

from __future__ import annotations

import contextlib
import os
import sys

from .stopping import STOPPING, end_process, follow_stdin, open_standard_streams

TYPE_CHECKING = False  # as typing has it, which is imported once signals are heard
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

_handle = None


def start(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line `arguments`, by default that of this process, and end the process with its exit status."""
    STOPPING.install()
    # Before numpy loads: on a busy machine, the threads of its BLAS wait for each other, even for small products.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_standard_streams()
    _require_media_foundation()
    with STOPPING.starting():
        follow_stdin()
        from .main import main
    STOPPING.run()
    try:
        status = main(arguments, guard=True)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        status = STOPPING.status
    except Exception:
        sys.excepthook(*sys.exc_info())
        status = 1
    _leave(status)


def _require_media_foundation() -> None:
    """End with a message if this Windows lacks a part that OpenCV needs."""
    if sys.platform == "win32":
        from ..core.puppet.windows_cameras import missing_media_foundation

        if missing := missing_media_foundation():
            sys.stderr.write(f"facemime: {missing}\n")
            _leave(1)


def _leave(status: int) -> NoReturn:
    """End the process at once.

    Signals during Python's own shutdown would change the exit status, and Blender's shutdown does not end if a scene
    contains a driver that was not run.
    """
    STOPPING.leave()
    if (guard := sys.modules.get(f"{__package__}.guard")) is not None:
        guard.end_child()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # the reader is gone
            stream.flush()
    if "bpy" in sys.modules:
        _remove_blenders_folder()
    end_process(status)


def _remove_blenders_folder() -> None:
    import shutil

    import bpy

    folder = os.path.normpath(bpy.app.tempdir) if bpy.app.tempdir else ""
    if os.path.basename(folder).startswith("blender_"):  # otherwise it is the general temporary folder
        shutil.rmtree(folder, ignore_errors=True)


def register() -> None:
    """Register the command with Blender."""
    import bpy

    global _handle  # noqa: PLW0603 - the handle is needed to unregister the command
    _handle = bpy.utils.register_cli_command("facemime", start)


def unregister() -> None:
    """Unregister the command."""
    import bpy

    bpy.utils.unregister_cli_command(_handle)
