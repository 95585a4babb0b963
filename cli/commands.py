"""`blender --command facemime ...`: the command line inside Blender."""

from typing import NoReturn

import bpy

_handle = None


def _run(arguments: list[str]) -> NoReturn:
    """Run the command, and end Blender with its exit status."""
    from .entry import start

    start(arguments)


def register() -> None:
    """Register the command with Blender."""
    global _handle  # noqa: PLW0603 - the handle is needed to unregister the command
    _handle = bpy.utils.register_cli_command("facemime", _run)


def unregister() -> None:
    """Unregister the command."""
    bpy.utils.unregister_cli_command(_handle)
