"""Operators that add the video and the sound of a performance, in sync with its take."""

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..blender.media.reference import add_reference
from ..blender.media.sound import add_sound
from ..blender.stubs import OperatorResult
from ..blender.timeline import rate_of
from ..core.errors import SourceError
from ..core.media.media_starts import sound_lead
from ..settings import takes_store
from ..settings.values import take_start
from .shared import AsksForFile, heads_in, report, require_heads
from .takes import OnTake


class OnTakesVideo(AsksForFile, OnTake):
    """Mixin: uses the video that the selected take was tracked from, and asks for it if it cannot be found."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the file if the video cannot be found."""
        if takes_store.video_of(context.scene, takes_store.chosen(context.scene)) is not None:
            return self.execute(context)
        return super().invoke(context, event)

    def video(self, scene: bpy.types.Scene) -> tuple[Path, float]:
        """Return the file, and the time in it at which the take's time is 0, seconds.

        Raises
        ------
        SourceError
            If the video cannot be found and no file was chosen.
        """
        line = takes_store.chosen(scene)
        path = self.path if self.filepath else takes_store.video_of(scene, line)
        if path is None:
            raise SourceError("The video of the take cannot be found. Choose the file.")
        return path, float(takes_store.read(line).info.get("offset", 0.0))


class FACEMIME_OT_add_sound(OnTakesVideo, bpy.types.Operator):
    """Add the sound of the take's video, or a sound file next to it, to the Sequencer in sync with the take"""

    bl_idname = "facemime.add_sound"
    bl_label = "Add Sound"

    filter_glob: StringProperty(default="*.mp4;*.mov;*.mkv;*.webm;*.avi;*.wav;*.flac;*.mp3;*.ogg", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        path, offset = self.video(scene)
        sound = path if self.filepath else takes_store.sound_beside(path)
        add_sound(scene, sound, take_start(scene) - (offset + sound_lead(sound)) * rate_of(scene))
        if scene.sync_mode != "AUDIO_SYNC":
            scene.sync_mode = "AUDIO_SYNC"
            report(self, "The playback of the scene is now synced to its sound")


class FACEMIME_OT_add_reference(OnTakesVideo, bpy.types.Operator):
    """Show the take's video next to the active head, in sync with the take"""

    bl_idname = "facemime.add_reference"
    bl_label = "Add Reference"

    filter_glob: StringProperty(default="*.mp4;*.mov;*.mkv;*.webm;*.avi", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a head and a take."""
        return require_heads(cls, context) and super().poll(context)

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        add_reference(scene, *self.video(scene), heads_in(context)[0], take_start(scene))


CLASSES = (FACEMIME_OT_add_sound, FACEMIME_OT_add_reference)
