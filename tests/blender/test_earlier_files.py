"""Takes, presets and .blend files of an earlier version can be opened and give the same motion.

The files in tests/data/before_floors were written by Facemime at commit e792407, in Blender 4.2: a scene with the
built-in head and settings other than the defaults, the same settings as a preset, a take of 60 frames, and the
result of that version: every eighth vertex and the poses of three frames. The neutral face that it found is kept, too,
since another one is found now.
"""

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.rigs import read_rig
from facemime.core.drive import posing, retarget
from facemime.core.puppet.performer import Performance
from facemime.core.takes.file import load_take
from facemime.settings import user_presets as presets
from facemime.settings.values import bake_settings, puppet_settings

FILES = Path(__file__).resolve().parents[1] / "data" / "before_floors"


@pytest.fixture(params=["as saved", "by preset"])
def scene(request) -> bpy.types.Scene:
    bpy.ops.wm.open_mainfile(filepath=str(FILES / "scene.blend"))
    scene = bpy.context.scene
    if request.param == "by preset":
        for group in (scene.facemime, scene.facemime.posing):
            for name in group.bl_rna.properties.keys():  # noqa: SIM118 - a Blender collection
                if group.bl_rna.properties[name].type in ("FLOAT", "BOOLEAN", "ENUM"):
                    group.property_unset(name)
        assert scene.facemime.mode == "3d" and scene.facemime.posing.eyes_strength == 1.0
        presets.load(scene.facemime, FILES / "preset.json")
    return scene


def test_old_settings_and_takes_give_the_same_motion_except_for_later_gains(scene, monkeypatch):
    monkeypatch.setattr(retarget, "_LIP_GAIN", (1.0, 1.0))
    monkeypatch.setattr(retarget, "_BROW_GAIN", 1.0)
    monkeypatch.setattr(retarget, "_BROW_TILT", 0.0)
    monkeypatch.setattr(retarget, "_WIDE_SHARE", 1.0)
    monkeypatch.setattr(retarget, "_ROUNDER", np.zeros_like(retarget._ROUNDER))
    monkeypatch.setattr(retarget, "_FACING_LIPS", ())
    monkeypatch.setattr(posing, "_MAX_FACTOR", 1.0)
    take = load_take(FILES / "take.facetake")
    neutral = json.loads((FILES / "neutral.json").read_text())
    take = replace(take, info={**take.info, "calibration": neutral})
    performance = Performance.of(take, puppet_settings(scene.facemime))
    driver = performance.driver(read_rig(next(obj for obj in scene.objects if obj.type == "MESH")))
    before = np.load(FILES / "motion.npz")
    for row, vertices, *poses in zip(*(before[name] for name in _NAMES), strict=True):
        frame = driver.frame(performance.take.result(int(row)))
        np.testing.assert_allclose(frame.vertices[::8], vertices, atol=2e-6)
        for eye in frame.gaze:
            np.testing.assert_allclose(eye, poses[-1], atol=1e-6)
        for now, then in zip((frame.rotation, frame.translation, frame.jaw), poses[:-1], strict=True):
            np.testing.assert_allclose(now, then, atol=1e-6)


_NAMES = ("rows", "vertices", "rotation", "translation", "jaw", "gaze")


def test_old_bake_settings_are_read(scene):
    bake = bake_settings(scene.facemime_takes.bake, "take")
    assert (bake.keys, bake.max_keys, bake.nla) == ("named", 12, True) and bake.clean == pytest.approx(0.005)
