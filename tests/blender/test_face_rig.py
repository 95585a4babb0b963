"""Rigify's face for a head without a rig; in a process of its own, as bpy may hang at its end after enabling Rigify."""

import json
import subprocess
import sys

import bpy
import pytest

from facemime.blender.heads.new_heads import add_head
from tests.helpers.face_rigs import make_face_rig

SCRIPT = """
import json, os, sys
def end(kind, error, trace):
    print(kind, error, flush=True)
    os._exit(1)
sys.excepthook = end
import bpy
import numpy as np
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.preferences.addon_enable(module="rigify")
from facemime import registration
registration.register()
from facemime.blender.characters import read_bones
from facemime.blender.controls.stored import read_controls
from facemime.blender.frames import to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import mesh_of, read_landmarks, read_vertices
from facemime.blender.rigs import read_rig

def shown(obj):
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    return np.array([vertex.co for vertex in mesh.vertices])

def placed(name):
    return np.array(bpy.data.objects[name].matrix_world)

def pose(rig, bone, **channels):
    for name, value in channels.items():
        setattr(rig.pose.bones[bone], name, value)
    bpy.context.view_layer.update()

add_head(bpy.context, woman={woman})
head = bpy.context.active_object
head.location, head.scale = (0.3, 0.2, 1.5), ({scale},) * 3
bpy.context.view_layer.update()
rest, objects = shown(head), sorted(obj.name for obj in bpy.data.objects)
eyes = {{name: placed(name) for name in ("Eye.L", "Teeth.Lower")}}
bpy.ops.ed.undo_push(message="before")
bpy.ops.facemime.add_face_rig()
found = {{}}
head = bpy.context.active_object
rig = read_bones(head)[0]
found["controls"], found["share"] = read_controls(head).controls, head.facemime_rig.shown
found["moved"] = float(np.abs(shown(head) - rest).max())
found["eyes"] = float(max(np.abs(placed(name) - was).max() for name, was in eyes.items()))
data, unit = read_rig(head), read_rig(head).eye_distance
lower, upper = data.landmarks[[64, 61]]
pose(rig, "jaw_master", rotation_mode="XYZ", rotation_euler=(0.3, 0.0, 0.0))
moved = np.linalg.norm(shown(head) - rest, axis=1) / unit
found["jaw"] = [float(moved[lower]), float(moved[upper])]
pose(rig, "jaw_master", rotation_euler=(0.0, 0.0, 0.0))
pose(rig, "head", rotation_mode="XYZ", rotation_euler=(0.0, 0.4, 0.0))
turned = np.linalg.norm(shown(head) - rest, axis=1) / unit
found["turned"] = float(turned[data.landmarks].min())
pose(rig, "head", rotation_euler=(0.0, 0.0, 0.0))
weights = np.array([sum(g.weight for g in v.groups if head.vertex_groups[g.group].name.startswith(("DEF", "ORG")))
                    for v in mesh_of(head).vertices])
found["weights"] = [float(weights.min()), float(weights.max())]
bpy.ops.ed.undo_push(message="after")
bpy.ops.ed.undo()
found["undone"] = sorted(obj.name for obj in bpy.data.objects) == objects
print("RESULT" + json.dumps(found))
sys.stdout.flush()
os._exit(0)
"""


def result(**options):
    """What the script prints."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(**options)], capture_output=True, text=True, timeout=150, check=False
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT")]
    assert lines, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(lines[0].removeprefix("RESULT"))


@pytest.mark.thorough
@pytest.mark.parametrize(("woman", "scale"), [(False, 1.0), (True, 10.0)])
def test_a_head_gets_a_rig_whose_controls_are_learnt_and_one_undo_removes_it(woman, scale):
    found = result(woman=woman, scale=scale)
    assert {"jaw_master", "lips.L", "lid.T.R.002", "brow.T.L.001"} <= set(found["controls"])
    assert found["share"] > 0.8
    assert found["moved"] < 1e-4 and found["eyes"] < 1e-4, "nothing moves at rest"
    lower, upper = found["jaw"]
    assert lower > 0.1 and upper < 0.3 * lower, "lips that touch part"
    assert found["turned"] > 0.05, "the bone of the head turns the whole face"
    assert found["weights"] == pytest.approx([1.0, 1.0], abs=0.02)
    assert found["undone"]


def test_a_head_with_a_rig_or_without_rigify_is_refused_and_left_alone():
    add_head(bpy.context)
    objects = len(bpy.data.objects)
    with pytest.raises(RuntimeError, match=r"Rigify is disabled\. Enable it in Preferences"):
        bpy.ops.facemime.add_face_rig()
    assert len(bpy.data.objects) == objects
    head, armature = make_face_rig()
    bpy.context.view_layer.objects.active = head
    with pytest.raises(RuntimeError, match=f"has a rig: {armature.name}"):
        bpy.ops.facemime.add_face_rig()
