"""Controls of a rig after a bake to shape keys, which moves keys of its own and mutes the drivers of others."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.controls.probing import Learning, learn_controls
from facemime.blender.controls.stored import read_controls, write_controls
from facemime.blender.controls.view import seen_vertices
from facemime.blender.meshes import mesh_of
from facemime.blender.names import MUTED_PROPERTY
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.errors import HeadError
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.sessions.show import TakeShow, follow_settings
from tests.helpers.face_rigs import bake, show
from tests.helpers.takes import performance
from tests.helpers.thorough import first_of

pytestmark = pytest.mark.usefixtures("nothing_left_over")
FRAMES = (20, 30, 40)


def shapes(head, frames=FRAMES):
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append(seen_vertices(head))
    return np.array(found)


def bake_keys(head, **options):
    """Bake to the shape keys of the head, and go to a frame with an expression."""
    settings = PuppetSettings(bake=BakeSettings(keys="named", **options), neutral=0.0)
    puppet_head(bpy.context.scene, head, performance(), settings)
    bpy.context.scene.frame_set(33)


def mutes(head):
    keys = mesh_of(head).shape_keys
    return [curve.mute for curve in keys.animation_data.drivers], [key.mute for key in keys.key_blocks]


@pytest.fixture(params=[True, False], ids=["driven keys", "free keys"])
def character(request, rigged):
    """A head whose controls were learnt, with keys that they drive, or that nothing drives."""
    head, _ = rigged
    if not request.param:
        for name in mesh_of(head).shape_keys.key_blocks.keys()[1:]:
            mesh_of(head).shape_keys.driver_remove(f'key_blocks["{name}"].value')
    bpy.context.view_layer.update()
    write_controls(head, learn_controls(head))
    return head


@pytest.mark.parametrize("nla", first_of([False, True]))
def test_the_same_controls_are_learnt_after_a_bake_to_keys(character, nla):
    before = learn_controls(character)
    bake_keys(character, nla=nla)
    muted = mutes(character)
    after = learn_controls(character)
    assert after.controls == before.controls and mutes(character) == muted
    np.testing.assert_allclose(after.effects, before.effects, atol=1e-4)


def test_learning_that_is_stopped_leaves_a_bake_as_it_was(character):
    bake_keys(character)
    muted, learning = mutes(character), Learning(character)
    steps = learning.steps()
    next(steps)
    learning.close()
    assert mutes(character) == muted


def test_a_preview_on_controls_replaces_a_bake_to_keys(character):
    session = show(character)
    wanted = shapes(character)
    session.close()
    bake_keys(character)
    muted = mutes(character)
    session = show(character)
    moved = np.abs(wanted - wanted[0]).max()
    assert np.abs(shapes(character) - wanted).max() < 0.02 * moved
    session.close()
    assert mutes(character) == muted


def test_a_preview_can_change_to_controls_over_a_bake_to_keys(character):
    bake_keys(character)
    muted = mutes(character)
    show(character, by="SKIN")
    bpy.context.scene.facemime.drive_by = "CONTROLS"
    follow_settings()
    assert TakeShow.running() is not None and TakeShow.running().heads[0].controls is not None
    TakeShow.running().close()
    assert mutes(character) == muted


def test_a_bake_to_controls_after_one_to_keys_is_the_same_as_without(character):
    bake(character, clean=0.0)
    wanted = shapes(character)
    bake_keys(character)
    bake(character, clean=0.0)
    assert np.abs(shapes(character) - wanted).max() < 0.02 * np.abs(wanted - wanted[0]).max()


def test_drivers_that_the_user_mutes_still_make_controls_stale(rigged):
    head, _ = rigged
    write_controls(head, learn_controls(head))
    bake_keys(head)
    read_controls(head)
    del mesh_of(head).shape_keys[MUTED_PROPERTY]  # as if it was not the bake that muted them
    with pytest.raises(HeadError, match="earn the controls again"):
        read_controls(head)
