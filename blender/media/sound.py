"""Sound of a performance in the Sequencer, in sync with the bake."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.errors import SourceError
from ..names import TAKE_PROPERTY

_CHANNEL = 1


def add_sound(scene: bpy.types.Scene, path: Path, frame: float) -> bpy.types.Strip:
    """Add a sound strip on a free channel.

    Parameters
    ----------
    path : Path
        A sound file or a video.
    frame : float
        Frame at which the sound starts.

    Raises
    ------
    SourceError
        If the file is missing or has no sound.
    """
    if not path.is_file():
        raise SourceError("The file {path} does not exist. Choose the video or the sound file of the take.", path=path)
    sound = bpy.data.sounds.load(str(path), check_existing=True)
    if sound.channels == "INVALID":
        bpy.data.sounds.remove(sound)
        raise SourceError("{name} contains no readable sound. Choose another file.", name=path.name)
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = strips_of(editor)
    channel = max((strip.channel for strip in strips), default=_CHANNEL - 1) + 1
    strip = strips.new_sound(path.stem, str(path), channel, int(frame // 1))
    strip.frame_start = frame
    strip[TAKE_PROPERTY] = True
    return strip


def strips_of(editor: bpy.types.SequenceEditor) -> bpy.types.StripsTopLevel:
    """Return the strips of a Sequencer in any version of Blender."""
    return editor.strips if hasattr(editor, "strips") else editor.sequences


def is_of_take(strip: bpy.types.Strip) -> bool:
    """Return whether Facemime added a strip, with the sound of a take."""
    return bool(strip.get(TAKE_PROPERTY, False))
