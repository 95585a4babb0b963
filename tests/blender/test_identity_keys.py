"""Shape keys that hold a character's identity stay in caches, and are no motion in sampled takes."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.sampling import Sampling
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.puppet.puppet_settings import PuppetSettings
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of


def _constant_key(block):
    block.keyframe_insert("value", frame=1)


def _driver(block):
    empty = bpy.data.objects.new("Age", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.location.x = 1.0
    driver = block.driver_add("value").driver
    driver.type = "AVERAGE"
    variable = driver.variables.new()
    variable.targets[0].id, variable.targets[0].data_path = empty, "location.x"


def head_with_identity(keep=lambda block: None):
    """A head with a wide face, kept in a key at 1, and its weights in a vertex group."""
    head = add_head(bpy.context, units=True)
    block = head.shape_key_add(name="Wide Face", from_mix=False)
    places = np.array([point.co for point in block.data])
    places[:, 0] *= 1.3
    block.data.foreach_set("co", places.reshape(-1))
    block.value = 1.0
    keep(block)
    bpy.context.view_layer.update()
    return head


def shape_at(head, frame):
    """(V, 3) evaluated vertices in a frame."""
    bpy.context.scene.frame_set(frame)
    mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


@pytest.mark.parametrize("keep", first_of([lambda block: None, _constant_key, _driver], 2))
def test_a_cache_contains_the_keys_of_the_identity(keep, tmp_path):
    head = head_with_identity(keep)
    before = shape_at(head, 1)
    settings = PuppetSettings(bake=BakeSettings(keys="cache", path=tmp_path / "a.pc2"))
    puppet_head(bpy.context.scene, head, performance(), settings)
    assert np.abs(shape_at(head, 1) - before).max() < 0.01
    settings = PuppetSettings(bake=BakeSettings(keys="new"))
    cached = [shape_at(head, frame) for frame in (20, 50)]
    puppet_head(bpy.context.scene, head, performance(), settings)
    for frame, shape in zip((20, 50), cached, strict=True):
        assert np.abs(shape_at(head, frame) - shape).max() < 2e-3


@pytest.mark.thorough
@pytest.mark.parametrize("keep", [lambda block: None, _constant_key, _driver])
def test_a_sampled_take_does_not_take_the_identity_for_an_expression(keep):
    takes = []
    for make in (lambda: add_head(bpy.context, units=True), lambda: head_with_identity(keep)):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        head = make()
        puppet_head(bpy.context.scene, head, performance(), PuppetSettings(bake=BakeSettings(keys="mapped")))
        sampling = Sampling(bpy.context.scene, head, "head")
        for _ in sampling:
            pass
        takes.append(sampling.take())
    plain, wide = (take.shape - take.shape[0] for take in takes)
    assert np.abs(takes[1].shape[0] - takes[0].shape[0]).max() < 0.2
    assert np.abs(plain - wide).max() < 0.12 and np.corrcoef(plain.reshape(-1), wide.reshape(-1))[0, 1] > 0.97
