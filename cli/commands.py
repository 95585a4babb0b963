"""`blender --command facemime ...`: the command line inside Blender."""

from typing import NoReturn

import bpy

_handle = None


def _run(arguments: list[str]) -> NoReturn:
    """Run the command and end Blender with its exit status; signals are heard as they are elsewhere."""
    from .entry import start

    start(arguments)


def register() -> None:
    """Make the command known to Blender."""
    global _handle  # noqa: PLW0603 - Blender hands out the only key with which the command is taken back
    _handle = bpy.utils.register_cli_command("facemime", _run)


def unregister() -> None:
    """Take the command back."""
    bpy.utils.unregister_cli_command(_handle)
