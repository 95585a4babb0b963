"""The sound of a performance on the sequencer, in step with what is baked from it."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.errors import SourceError

_CHANNEL = 1


def add_sound(scene: bpy.types.Scene, path: Path, frame: float) -> bpy.types.Strip:
    """Put the sound of the file at `path`, a video's too, onto a free channel, with its beginning at `frame`.

    Raises
    ------
    SourceError
        Where the file is missing or has no sound.
    """
    if not path.is_file():
        raise SourceError(f"There is no file {path}. Choose the video or the sound that belongs to the take.")
    sound = bpy.data.sounds.load(str(path), check_existing=True)
    if sound.channels == "INVALID":
        bpy.data.sounds.remove(sound)
        raise SourceError(f"{path.name} has no sound that can be read. Choose another file.")
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    channel = max((strip.channel for strip in strips), default=_CHANNEL - 1) + 1
    strip = strips.new_sound(path.stem, str(path), channel, int(frame // 1))
    strip.frame_start = frame
    return strip
