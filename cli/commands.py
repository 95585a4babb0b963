"""`blender --command facemime ...`: the command line inside Blender."""

import bpy

_handle = None


def _run(arguments: list[str]) -> int:
    from ..batch.leash import follow_stdin
    from . import main as cli
    from .stopping import open_standard_streams

    open_standard_streams()
    follow_stdin()
    return cli.main(arguments)


def register() -> None:
    """Make the command known to Blender."""
    global _handle  # noqa: PLW0603 - Blender hands out the only key with which the command is taken back
    _handle = bpy.utils.register_cli_command("facemime", _run)


def unregister() -> None:
    """Take the command back."""
    bpy.utils.unregister_cli_command(_handle)
