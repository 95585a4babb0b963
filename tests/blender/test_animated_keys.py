"""An animation of known shape keys is those keys: a take of it states them, and a mapped bake gives them back."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.puppet import puppet_head
from facemime.blender.animation.sampling import Sampling
from facemime.blender.heads.new_heads import add_head
from facemime.core.bake import arkit
from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.bake.bake_settings import BakeSettings
from facemime.core.bake.fit import fit_keys
from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, EXCLUSIVE_NAMES, FITTED
from facemime.core.heads.built_in import load_head
from facemime.core.heads.key_map import exclusive_keys
from facemime.core.heads.key_presets import best_preset
from facemime.core.puppet.puppet_settings import PuppetSettings
from facemime.core.takes.neutral import calibrate

FRAMES = 16
EXCLUSIVE = np.array([[COEFFICIENT_INDEX[name] for name in pair] for pair in EXCLUSIVE_NAMES])


def performance(count, seed=3):
    """Values (FRAMES, count) of keys, of which a third moves at a time; the first frame is at rest."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(0.0, 1.0, (FRAMES, count)) * (rng.uniform(size=(FRAMES, count)) < 1 / 3)
    values[0] = 0.0
    return values


def animate(head, names, values):
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, FRAMES
    blocks = head.data.shape_keys.key_blocks
    for name, column in zip(names, values.T, strict=True):
        for frame, value in enumerate(column, start=1):
            blocks[name].value = value
            blocks[name].keyframe_insert("value", frame=frame)


def sampled(head):
    sampling = Sampling(bpy.context.scene, head, "test")
    for _ in sampling:
        pass
    return sampling.take()


@pytest.fixture
def head():
    return add_head(bpy.context, units=True)


def test_animated_arkit_keys_are_the_coefficients_even_if_they_contradict_each_other(head):
    values = performance(len(COEFFICIENTS))
    values[1:, EXCLUSIVE] = 0.5
    animate(head, COEFFICIENTS, values)
    take = sampled(head)
    np.testing.assert_allclose(take.coefficients, values, atol=2e-5)
    np.testing.assert_allclose(arkit_coefficients(take, calibrate(take)), values, atol=2e-5)


def test_a_mapped_bake_on_another_head_has_the_same_values(head):
    values = performance(len(COEFFICIENTS))
    animate(head, COEFFICIENTS, values)
    take, other = sampled(head), add_head(bpy.context, units=True)
    puppet_head(bpy.context.scene, other, take, PuppetSettings(bake=BakeSettings(keys="mapped", clean=0.0)))
    for frame, row in enumerate(values, start=1):
        bpy.context.scene.frame_set(frame)
        baked = [other.data.shape_keys.key_blocks[name].value for name in COEFFICIENTS]
        np.testing.assert_allclose(baked, row, atol=2e-5)


def test_keys_that_drivers_move_count_and_muted_ones_do_not(head):
    animate(head, ["jawOpen", "cheekPuff"], performance(2))
    blocks = head.data.shape_keys.key_blocks
    blocks["cheekPuff"].mute = True
    driver = blocks["tongueOut"].driver_add("value").driver
    driver.type = "SUM"
    target = driver.variables.new().targets[0]
    target.id_type, target.id = "KEY", head.data.shape_keys
    target.data_path = 'key_blocks["jawOpen"].value'
    found = sampled(head).coefficients
    np.testing.assert_allclose(found[:, COEFFICIENT_INDEX["jawOpen"]], performance(2)[:, 0], atol=2e-5)
    np.testing.assert_allclose(found[:, COEFFICIENT_INDEX["tongueOut"]], performance(2)[:, 0], atol=2e-5)
    assert not found[:, COEFFICIENT_INDEX["cheekPuff"]].any()


def test_negative_keys_are_the_opposite_coefficients_and_exaggerated_ones_are_said(head):
    blocks = head.data.shape_keys.key_blocks
    blocks["mouthLeft"].slider_min, blocks["jawOpen"].slider_max = -1.0, 2.0
    values = np.column_stack([np.linspace(-0.5, 0.5, FRAMES), np.linspace(0.0, 1.5, FRAMES)])
    animate(head, ["mouthLeft", "jawOpen"], values)
    take = sampled(head)
    found = take.coefficients[:, [COEFFICIENT_INDEX[name] for name in ("mouthLeft", "mouthRight", "jawOpen")]]
    wanted = np.column_stack([values[:, 0], -values[:, 0], values[:, 1]])
    np.testing.assert_allclose(found, np.clip(wanted, 0.0, 1.0), atol=2e-5)
    assert len(take.info["notes"]) == 1 and "jawOpen" in take.info["notes"][0]


def test_eyes_that_are_turned_without_keys_look_where_they_are_turned(head):
    animate(head, ["jawOpen"], performance(1))
    for eye in (child for child in head.children if "eye" in child.name.lower()):
        for frame, turn in ((1, 0.0), (FRAMES, -0.3)):
            eye.delta_rotation_euler.z = turn
            eye.keyframe_insert("delta_rotation_euler", frame=frame)
    last = dict(zip(COEFFICIENTS, sampled(head).coefficients[-1], strict=True))
    assert last["eyeLookInLeft"] > 0.2 < last["eyeLookOutRight"] and last["eyeLookOutLeft"] < 0.01
    assert last["jawOpen"] == pytest.approx(performance(1)[-1, 0], abs=2e-5)


def test_a_head_whose_keys_do_not_move_is_measured(head):
    head.shape_key_add(name="Basis only")
    values = performance(1)
    animate(head, ["Basis only"], values)
    block = head.data.shape_keys.key_blocks["Basis only"]
    for point, jaw in zip(block.data, head.data.shape_keys.key_blocks["jawOpen"].data, strict=True):
        point.co = jaw.co
    take = sampled(head)
    assert np.isnan(take.coefficients).all()
    found = arkit_coefficients(take, calibrate(take))[:, COEFFICIENT_INDEX["jawOpen"]]
    np.testing.assert_allclose(found, values[:, 0], atol=0.03)


def test_keys_of_another_known_set_are_given_back_by_its_mapping(head):
    names = ("aa", "ih", "ou", "ee", "oh", "blinkLeft", "blinkRight")
    blocks = head.data.shape_keys.key_blocks
    for name, mixture in zip(KEY_SETS["vrm"].names, KEY_SETS["vrm"].mixtures, strict=True):
        for unit, weight in zip(COEFFICIENTS, mixture, strict=True):
            blocks[unit].value = weight
        if name in names:
            head.shape_key_add(name=name, from_mix=True)
    for unit in COEFFICIENTS:
        head.shape_key_remove(blocks[unit])
    for block in blocks:
        block.value = 0.0
    values = np.zeros((FRAMES, len(names)))
    values[np.arange(1, FRAMES), np.arange(1, FRAMES) % len(names)] = 0.6
    animate(head, names, values)
    take = sampled(head)
    table = best_preset(names)
    found = table.apply(take.coefficients.astype(float), dict.fromkeys(names, (0.0, 1.0)))
    single = [column for column, name in enumerate(names) if name.startswith("blink")]
    for column in single:
        np.testing.assert_allclose(found[names[column]], values[:, column], atol=1e-3)
    assert np.abs(np.column_stack([found[name] for name in names]) - values).mean() < 0.03


@pytest.mark.parametrize("pair", EXCLUSIVE_NAMES[:6])
def test_coefficients_that_are_solved_for_exclude_their_opposites(pair):
    built_in, amounts = load_head(), np.linspace(0.0, 1.0, 5)
    columns = [COEFFICIENT_INDEX[name] for name in pair]
    units = built_in.units[columns][:, built_in.landmarks].astype(float)
    rng = np.random.default_rng(0)
    moved = np.einsum("n,kvc->nvc", amounts, units) + 0.1 * rng.normal(size=(5, *units.shape[1:])) * units.std()
    found = arkit._fitted(moved)
    places = np.searchsorted(FITTED, columns)
    assert not found[:, places].min(axis=1).any()


def test_fitted_keys_exclude_their_opposites_as_well():
    assert exclusive_keys(["Jaw_Right", "x", "jawLeft", "mouthLeft"]) == [(2, 0)]
    keys = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    motion = np.array([[[0.2, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    free = fit_keys(motion, keys, np.zeros(2), np.ones(2)).weights
    (found,) = fit_keys(motion, keys, np.zeros(2), np.ones(2), [(0, 1)]).weights
    assert free.min() > 0.3 and found[1] == 0.0 and found[0] == pytest.approx(0.6, abs=0.01)
