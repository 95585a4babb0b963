"""The key mapping: detecting, editing, sharing and learning it."""

import bpy
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.heads.key_map import load_map

pytestmark = pytest.mark.usefixtures("in_a_project")


def test_a_key_table_is_detected_edited_shared_and_learnt(imported, takes, tmp_path):
    head, bake = add_head(bpy.context, units=True), takes.bake
    assert bpy.ops.facemime.detect_key_map() == {"FINISHED"} and len(bake.rows) == 52
    bake.row = [row.key for row in bake.rows].index("tongueOut")
    assert bpy.ops.facemime.remove_key_row() == {"FINISHED"} and len(bake.rows) == 51
    assert bpy.ops.facemime.add_key_row() == {"FINISHED"}
    bake.keys = "mapped"
    with pytest.raises(RuntimeError, match="Row 52 of the key mapping has no shape key"):
        bpy.ops.facemime.bake_take()
    bake.rows[51].key, bake.rows[51].gain = "tongueOut", 0.25
    assert bpy.ops.facemime.export_key_map(filepath=str(tmp_path / "mine.json")) == {"FINISHED"}
    assert load_map(tmp_path / "mine.json").rows[51].gain == 0.25
    assert bpy.ops.facemime.import_key_map(filepath=str(tmp_path / "mine.json")) == {"FINISHED"}
    assert not bpy.ops.facemime.learn_key_map.poll()
    for frame, value in ((1, 0.0), (35, 0.8), (45, 0.8)):
        bpy.context.scene.frame_set(frame)
        head.data.shape_keys.key_blocks["cheekPuff"].value = value
        assert bpy.ops.facemime.add_key_pose() == {"FINISHED"}
    assert bpy.ops.facemime.learn_key_map() == {"FINISHED"} and not len(bake.poses)
    assert sum(row.gain for row in bake.rows if row.key == "cheekPuff" and row.source != "cheekPuff") > 0.2
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    bpy.context.scene.frame_set(35)
    # The gains are a compromise of three poses, two of which have the same value at different coefficients.
    assert head.data.shape_keys.key_blocks["cheekPuff"].value == pytest.approx(0.8, abs=0.15)


def test_no_table_is_detected_for_unknown_shape_keys():
    head = add_head(bpy.context)
    for name in ("Basis", "Fat"):
        head.shape_key_add(name=name, from_mix=False)
    with pytest.raises(RuntimeError, match="No preset matches"):
        bpy.ops.facemime.detect_key_map()


@pytest.mark.thorough
@pytest.mark.parametrize("data", ["", "[]", '{"values": {}}', '{"coefficients": [NaN], "values": {}}', "[" * 100_000])
def test_a_damaged_pose_is_removed_and_reported(imported, takes, data):
    add_head(bpy.context, units=True)
    assert bpy.ops.facemime.add_key_pose() == {"FINISHED"}
    takes.bake.poses.add().data = data
    with pytest.raises(RuntimeError, match="stored pose is damaged"):
        bpy.ops.facemime.learn_key_map()
    assert len(takes.bake.poses) == 1
