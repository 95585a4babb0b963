"""Bakes that are impossible are reported before anything has changed; linked and overridden heads."""

from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from facemime.blender.animation.bake_keys import read_keys
from facemime.blender.animation.puppet import puppet_head, puppet_heads
from facemime.blender.animation.targets import PoseTarget
from facemime.blender.characters import members_of
from facemime.blender.heads.new_heads import add_head
from facemime.core.errors import FacemimeError, HeadError, OutputError, SourceError
from facemime.core.heads.key_map import KeyMap, KeyRow
from tests.helpers.bakes import armature, bake, largest_error
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("at_the_takes_rate")


def test_a_strip_that_is_tweaked_stops_a_bake_before_anything_has_changed():
    head, rig = add_head(bpy.context), armature("Head")
    rig.pose.bones["Head"].keyframe_insert("rotation_quaternion", frame=1)
    data = rig.animation_data
    data.nla_tracks.new().strips.new("Walk", 1, data.action)
    data.action = None
    data.use_tweak_mode = True
    if not data.use_tweak_mode:
        pytest.skip("this Blender enters Tweak Mode in its editor only")
    with pytest.raises(HeadError, match="Tweak Mode"):
        bake(head, {"head": PoseTarget.of(rig, "Head")})
    assert head.data.shape_keys is None


def library(tmp_path: Path, **options) -> Path:
    """Save a head to a file, and return to an empty one."""
    head = add_head(bpy.context, **options)
    path = tmp_path / "library.blend"
    bpy.data.libraries.write(str(path), {head, *head.children})
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.fps = 25
    return path


def linked(path: Path) -> bpy.types.Object:
    """Link the head of another file into the scene."""
    with bpy.data.libraries.load(str(path), link=True) as (_, data):
        data.objects = ["Facemime Head"]
    bpy.context.collection.objects.link(data.objects[0])
    return data.objects[0]


def test_a_linked_head_is_refused_and_an_overridden_one_plays_a_cache(tmp_path):
    head = linked(library(tmp_path))
    for keys in ("new", "cache"):
        with pytest.raises(HeadError, match="linked from another file"):
            bake(head, keys=keys, path=tmp_path / "a.pc2")
    own = head.override_create(remap_local_usages=True)
    with pytest.raises(HeadError, match="shape keys cannot be added"):
        bake(own)
    report = bake(own, keys="cache", path=tmp_path / "a.pc2")
    assert largest_error(own, report) < 1e-4


def test_an_overridden_head_with_linked_keys_is_reported(tmp_path):
    own = linked(library(tmp_path, units=True)).override_create(remap_local_usages=True)
    with pytest.raises(HeadError, match="linked from another file"):
        bake(own, keys="named")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keys": "named"}, "has no shape keys"),
        ({"keys": "mapped"}, "has no shape keys"),
        ({"keys": "cache"}, "has no file name"),
    ],
)
def test_missing_requirements_are_reported_before_anything_changes(options, message):
    head = add_head(bpy.context)
    with pytest.raises(FacemimeError, match=message):
        bake(head, **options)
    assert head.data.shape_keys is None and head.animation_data is None and len(head.modifiers) == 1


@pytest.mark.thorough
def test_unmatched_and_absolute_shape_keys_are_rejected():
    head = add_head(bpy.context)
    for name in ("Basis", "Fat", "Thin"):
        head.shape_key_add(name=name, from_mix=False)
    with pytest.raises(HeadError, match="No key mapping preset matches"):
        bake(head, keys="mapped")
    with pytest.raises(HeadError, match="key mapping mine matches none"):
        bake(head, keys="mapped", table=KeyMap("mine", (KeyRow("jawOpen", "Open"),)))
    head.data.shape_keys.use_relative = False
    with pytest.raises(HeadError, match="absolute"):
        read_keys(members_of(head))
    with pytest.raises(HeadError, match="absolute"):
        bake(head)


def test_a_cache_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="Cannot write"):
        bake(add_head(bpy.context), keys="cache", path=tmp_path / "file" / "a.pc2")


@pytest.mark.parametrize("start", [1.7e9, -1.7e9])
def test_times_beyond_blenders_last_frame_are_reported_and_nothing_changes(start):
    head, take = add_head(bpy.context), performance()
    with pytest.raises(SourceError, match="beyond Blender's last frame"):
        puppet_head(bpy.context.scene, head, replace(take, times=take.times + start))
    assert head.data.shape_keys is None and head.animation_data is None


def test_several_heads_are_baked_all_or_none(tmp_path):
    heads = [add_head(bpy.context, name=name) for name in ("One", "Two")]
    heads[1].vertex_groups.clear()
    with pytest.raises(HeadError, match="Missing vertex groups of Two"):
        puppet_heads(bpy.context.scene, heads, performance())
    assert all(head.data.shape_keys is None and head.animation_data is None for head in heads)
