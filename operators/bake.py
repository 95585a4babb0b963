"""Operators that bake the selected take, add its sound and video, and edit the key mapping."""

from pathlib import Path

import bpy
import numpy as np
from bpy.props import StringProperty

from ..blender.animation.conflicts import mute_under, playing_under
from ..blender.animation.corrections import add_layer, remove_layer
from ..blender.animation.puppet import preset_for, puppet_heads
from ..blender.meshes import can_be_driven, key_names, keys_of
from ..blender.reference import add_reference, add_sound
from ..blender.stubs import OperatorResult
from ..blender.timeline import frames_of, rate_of
from ..core.bake.arkit import arkit_coefficients
from ..core.errors import FacemimeError, HeadError, SourceError
from ..core.files.media_headers import sound_lead
from ..core.files.suffixes import VIDEO_SUFFIXES, shown_files
from ..core.files.writing import replacing
from ..core.heads.key_map import KeyMap, KeyPose, learn_map, load_map
from ..core.heads.key_presets import presets
from ..core.takes.neutral import calibrate
from ..sessions.session import Session
from ..settings import takes_store
from ..settings.takes_properties import FacemimeBake, read_table, write_table
from ..settings.values import bake_settings, drive_settings, place_take, pose_targets, puppet_settings, take_start
from .shared import (
    AsksForFile,
    AsksForFileToWrite,
    OnHead,
    ReportsErrors,
    heads_in,
    report,
    reporting_range,
    require,
    require_heads,
    require_object_mode,
    required_subject,
    subject,
)
from .takes import OnTake, require_take


class FACEMIME_OT_bake_take(OnTake, bpy.types.Operator):
    """Bake the selected take to the active head and all other selected heads"""

    bl_idname = "facemime.bake_take"
    bl_label = "Bake Take"
    needs = (require_object_mode, require_heads, require_take)

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        line = takes_store.chosen(scene)
        take = takes_store.read_corrected(context.scene, line)
        if (session := Session.running()) is not None:
            session.close()
        heads = heads_in(context)
        settings = puppet_settings(scene.facemime, bake_settings(scene.facemime_takes.bake, line.name))
        targets = pose_targets(scene.facemime.posing, heads[0])
        place_take(scene)
        with reporting_range(self, scene):
            bake, *_ = puppet_heads(scene, heads, take, settings, targets)
        context.window_manager.facemime.recorded = ""
        frames, summary = len(bake.motion.times), bake.summary()
        report(self, "{frames} frames, {summary}", frames=frames, summary=summary)
        for warning in bake.warnings:
            report(self, warning, "WARNING")


class FACEMIME_OT_mute_others(OnHead, bpy.types.Operator):
    """Mute actions and NLA tracks that move the character's shape keys in addition to the bake"""

    bl_idname = "facemime.mute_others"
    bl_label = "Mute Other Animation"

    needs_landmarks = False

    def work(self, context: bpy.types.Context) -> None:
        names = ", ".join(playing_under(required_subject(context)))
        count = mute_under(required_subject(context))
        report(self, "{count} curves and tracks muted: {names}", count=count, names=names)


class FACEMIME_OT_add_corrections(OnHead, bpy.types.Operator):
    """Add a layer for your own keyframes to the bake of the active head. Another bake leaves them as they are"""

    bl_idname = "facemime.add_corrections"
    bl_label = "Add Correction Layer"

    needs_landmarks = False

    def work(self, context: bpy.types.Context) -> None:
        name = add_layer(required_subject(context))
        report(self, "Keyframes of shape keys and bones now go to {name} and are added to the bake", name=name)


class FACEMIME_OT_remove_corrections(OnHead, bpy.types.Operator):
    """Remove the layer of corrections of the active head. Its action is kept in the file if you use it elsewhere"""

    bl_idname = "facemime.remove_corrections"
    bl_label = "Remove Correction Layer"

    needs_landmarks = False

    def work(self, context: bpy.types.Context) -> None:
        remove_layer(required_subject(context))


class FACEMIME_OT_detect_key_map(OnHead, bpy.types.Operator):
    """Fill the key mapping from the preset that best fits the names of the head's shape keys"""

    bl_idname = "facemime.detect_key_map"
    bl_label = "Detect Mapping"

    needs_landmarks = False

    def work(self, context: bpy.types.Context) -> None:
        table = preset_for(required_subject(context))
        if table is None:
            names = ", ".join(preset.name for preset in presets())
            raise HeadError(
                "No preset matches the shape keys of {name} ({names}). "
                "Add rows manually, import a mapping, or learn one from poses.",
                name=required_subject(context).name,
                names=names,
            )
        write_table(context.scene.facemime_takes.bake, table)
        report(self, table.summary())


class FACEMIME_OT_add_key_row(ReportsErrors, bpy.types.Operator):
    """Add a row to the key mapping"""

    bl_idname = "facemime.add_key_row"
    bl_label = "Add Row"

    def work(self, context: bpy.types.Context) -> None:
        """Add a row and select it."""
        bake = context.scene.facemime_takes.bake
        bake.rows.add()
        bake.row = len(bake.rows) - 1


class FACEMIME_OT_remove_key_row(ReportsErrors, bpy.types.Operator):
    """Remove the selected row from the key mapping"""

    bl_idname = "facemime.remove_key_row"
    bl_label = "Remove Row"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a selected row."""
        bake = context.scene.facemime_takes.bake
        return 0 <= bake.row < len(bake.rows)

    def work(self, context: bpy.types.Context) -> None:
        """Remove the row and select its neighbour."""
        bake = context.scene.facemime_takes.bake
        bake.rows.remove(bake.row)
        bake.row = max(0, min(bake.row, len(bake.rows) - 1))


class FACEMIME_OT_import_key_map(AsksForFile, bpy.types.Operator):
    """Import a key mapping from a file"""

    bl_idname = "facemime.import_key_map"
    bl_label = "Import Mapping"

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Read the file into the table."""
        write_table(context.scene.facemime_takes.bake, load_map(self.path))


class FACEMIME_OT_export_key_map(AsksForFileToWrite, bpy.types.Operator):
    """Export the key mapping to a file"""

    bl_idname = "facemime.export_key_map"
    bl_label = "Export Mapping"

    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        """Write the file."""
        with replacing(self.path_ending(".json")) as temporary:
            temporary.write_text(read_table(context.scene.facemime_takes.bake).to_json() + "\n", encoding="utf-8")


class FACEMIME_OT_add_key_pose(OnTake, bpy.types.Operator):
    """Add the current values of the head's shape keys as the pose that the take should give at the current frame"""

    bl_idname = "facemime.add_key_pose"
    bl_label = "Add Pose"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a head with shape keys, and a take."""
        obj = subject(context)
        keyed = obj is not None and can_be_driven(obj) and bool(key_names(obj))
        return require(cls, keyed, "Select a head that has shape keys") and super().poll(context)

    def work(self, context: bpy.types.Context) -> None:
        scene, blocks = context.scene, keys_of(required_subject(context)).key_blocks
        take = takes_store.read(takes_store.chosen(scene))
        frames = frames_of(scene, take.times[take.found], take_start(scene))
        coefficients = arkit_coefficients(take, calibrate(take), drive_settings(scene.facemime))
        current = coefficients[int(np.abs(frames - scene.frame_current_final).argmin())]
        values = {name: blocks[name].value for name in key_names(required_subject(context))}
        scene.facemime_takes.bake.poses.add().data = KeyPose(current, values).to_json()


class FACEMIME_OT_learn_key_map(ReportsErrors, bpy.types.Operator):
    """Adjust the gains of the key mapping to reproduce the added poses; the rest is left unchanged"""

    bl_idname = "facemime.learn_key_map"
    bl_label = "Learn from Poses"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require at least one pose."""
        some = len(context.scene.facemime_takes.bake.poses) > 0
        return require(cls, some, "Set the head's shape keys at a frame of the take and add that pose first")

    def work(self, context: bpy.types.Context) -> None:
        """Learn the table and clear the poses."""
        bake = context.scene.facemime_takes.bake
        poses = _poses(bake)
        posed = {name for pose in poses for name, value in pose.values.items() if value != 0.0}
        keys = sorted(posed | {row.key for row in bake.rows if all(row.key in pose.values for pose in poses)})
        if not posed:
            raise FacemimeError(
                "All shape keys are 0 in every pose. Set the head's shape keys, then add the pose again."
            )
        coefficients = np.array([pose.coefficients for pose in poses])
        values = np.array([[pose.values.get(key, 0.0) for key in keys] for pose in poses])
        start = read_table(bake) if len(bake.rows) else KeyMap("Mapping", ())
        write_table(bake, learn_map(coefficients, values, keys, start))
        bake.poses.clear()


def _poses(bake: FacemimeBake) -> list[KeyPose]:
    """Return the added poses; a damaged one is removed and raises SourceError."""
    poses = []
    for number, pose in enumerate(bake.poses):
        try:
            poses.append(KeyPose.from_json(pose.data))
        except SourceError:
            bake.poses.remove(number)
            raise
    return poses


class _OnTakesVideo(AsksForFile, OnTake):
    """Mixin: uses the video that the selected take was tracked from, and asks for it if it cannot be found."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the file if the video cannot be found."""
        if takes_store.video_of(context.scene, takes_store.chosen(context.scene)) is not None:
            return self.execute(context)
        return super().invoke(context, event)

    def video(self, scene: bpy.types.Scene) -> tuple[Path, float]:
        """Return the file, and the time in it at which the take's time is 0, seconds.

        Raises SourceError if the video cannot be found and no file was chosen.
        """
        line = takes_store.chosen(scene)
        path = self.path if self.filepath else takes_store.video_of(scene, line)
        if path is None:
            raise SourceError("The video of the take cannot be found. Choose the file.")
        return path, float(takes_store.read(line).info.get("offset", 0.0))


class FACEMIME_OT_add_sound(_OnTakesVideo, bpy.types.Operator):
    """Add the sound of the take's video, or a sound file next to it, to the Sequencer in sync with the take"""

    bl_idname = "facemime.add_sound"
    bl_label = "Add Sound"

    filter_glob: StringProperty(default=shown_files(*sorted(VIDEO_SUFFIXES), *takes_store.SOUNDS), options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        path, offset = self.video(scene)
        sound = path if self.filepath else takes_store.sound_beside(path)
        add_sound(scene, sound, take_start(scene) - (offset + sound_lead(sound)) * rate_of(scene))
        if scene.sync_mode != "AUDIO_SYNC":
            scene.sync_mode = "AUDIO_SYNC"
            report(self, "The playback of the scene is now synced to its sound")


class FACEMIME_OT_add_reference(_OnTakesVideo, bpy.types.Operator):
    """Show the take's video next to the active head, in sync with the take"""

    bl_idname = "facemime.add_reference"
    bl_label = "Add Reference"
    needs = (require_heads, require_take)

    filter_glob: StringProperty(default=shown_files(*sorted(VIDEO_SUFFIXES)), options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> None:
        scene = context.scene
        add_reference(scene, *self.video(scene), heads_in(context)[0], take_start(scene))
