"""Bakes of the performance, and what a head shows when they play."""

import bpy
import numpy as np

from facemime.blender.animation.bake_report import PuppetReport
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.frames import from_blender
from facemime.blender.rigs import read_rig
from facemime.blender.timeline import frames_of
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.drive.driver import HeadDriver
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.smooth import smooth_take
from tests.helpers.takes import performance


def bake(head: bpy.types.Object, targets=None, **options) -> PuppetReport:
    """Bake the performance, relative to its first second, in which it rests."""
    bake = BakeSettings(**{"whole_frames": False, **options})
    settings = PuppetSettings(bake=bake, translation=True, neutral=0.0)
    return puppet_head(bpy.context.scene, head, performance(), settings, targets)


def played(head: bpy.types.Object, report: PuppetReport, row: int) -> np.ndarray:
    """Return (V, 3) vertices in the head frame, with the scene at the time of a row of the motion."""
    frame = frames_of(bpy.context.scene, report.motion.times[row])
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=float(frame % 1.0))
    mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return from_blender(flat.reshape(-1, 3))


def largest_error(head: bpy.types.Object, report: PuppetReport) -> float:
    """Return the largest difference between playback and live frames in the whole take, eye distances."""
    rig = read_rig(head)
    take = smooth_take(performance())
    driver, worst = HeadDriver(rig, report.neutral), 0.0
    for row, frame in enumerate(np.flatnonzero(take.found)):
        away = played(head, report, row) - driver.frame(take.result(int(frame))).vertices[: len(rig.vertices)]
        worst = max(worst, float(np.linalg.norm(away, axis=1).max()))
    return worst / rig.eye_distance


def armature(*bones: str) -> bpy.types.Object:
    """Add an armature at the origin whose bones have various orientations."""
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for i, name in enumerate(bones):
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail, bone.roll = (0.1 * i, 0.0, 0.0), (0.1 * i, 0.05 * i - 0.1, 0.1), 0.3 * i
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig
