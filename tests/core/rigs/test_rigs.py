"""Maps of rigs and their solutions, on known linear rigs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.errors import SourceError
from facemime.core.face.landmarks import outer_eye_distance
from facemime.core.heads.built_in import load_head
from facemime.core.rigs.rig_map import LOCATION, PROPERTY, ROTATION, SCALE, Probe, RigChannel, map_of
from facemime.core.rigs.solver import RigSolver, share_shown
from facemime.core.rigs.storing import from_bytes, to_bytes

UNIT = 2.0
RIG = {("face", 0, ""): "1f", ("bone", 0, "lip"): "2e"}
SAMPLE = np.arange(90)


def effect(seed, size=0.1):
    """Smooth displacements (90, 3) that a control causes, at most `size` eye distances."""
    random = np.random.default_rng(seed)
    moved = random.normal(size=(90, 3)) * np.exp(-np.abs(np.arange(90) - random.integers(0, 66)) / 6.0)[:, None]
    return size * UNIT * moved / np.linalg.norm(moved, axis=1).max()


def bone(name, seed, step=0.2, low=-np.inf, high=np.inf, kink=None):
    """Channel and probes of a bone; the other direction does `kink` if that is given."""
    channel = RigChannel("Rig", name, LOCATION, 1, low=low, high=high, unit=UNIT)
    up, down = min(step, high), min(step, -low)
    probes = [Probe(up, effect(seed) * up / step)] if up > 0.0 else []
    if down > 0.0:
        probes.append(Probe(-down, -effect(seed) * down / step if kink is None else effect(kink) * down / step))
    return channel, probes


def mapped(*bones):
    channels, probes = zip(*bones, strict=True)
    return map_of(channels, probes, SAMPLE, UNIT)


def test_a_linear_channel_is_one_variable_and_a_kinked_one_two():
    found = mapped(bone("a", 1), bone("b", 2, kink=9))
    assert found.controls == ["a", "b"]
    assert found.channel.tolist() == [0, 1, 1]
    assert found.opposite.tolist() == [-1, 2, 1]
    assert found.doubt[0] < 0.01 < 0.5 < found.doubt[1]


def test_a_channel_that_does_not_move_the_face_is_left_out():
    still = RigChannel("Rig", "still", PROPERTY, name="p", low=0.0, high=1.0)
    found = map_of([still, bone("a", 1)[0]], [[Probe(0.5, np.zeros((90, 3)))], bone("a", 1)[1]], SAMPLE, UNIT)
    assert found.controls == ["a"]


@pytest.mark.parametrize(("low", "high"), [(-0.05, 0.3), (0.0, 0.3), (-0.4, 0.0)])
def test_bounds_are_those_of_the_channel(low, high):
    found = mapped(bone("a", 1, low=low, high=high))
    ends = sorted(float(found.values(end)[0]) for end in (found.lower, found.upper))
    assert ends == pytest.approx([low, high])


def test_a_scale_without_a_limit_is_at_most_half_as_large_again():
    scale = RigChannel("Rig", "lip", SCALE, 1, low=-0.2, rest=1.0)
    found = mapped((scale, [Probe(0.5, effect(6)), Probe(-0.2, -0.4 * effect(6))]))
    assert [float(found.values(end)[0]) for end in (found.lower, found.upper)] == pytest.approx([-0.2, 0.5])


def test_a_control_belongs_to_the_region_that_it_moves_most():
    moved = np.zeros((90, 3))
    moved[20] = 0.2
    found = mapped((RigChannel("Rig", "x", LOCATION, unit=UNIT), [Probe(0.1, moved)]))
    assert found.regions == {"x": "Brows"}


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4))
def test_the_values_that_made_a_pose_are_found_again(values):
    found = mapped(*(bone(str(number), number) for number in range(4)))
    wanted = np.einsum("k,ksc->sc", values, found.effects)
    solved = RigSolver(found).variables(wanted)
    np.testing.assert_allclose(solved, values, atol=0.1)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.1, 5.0))
def test_no_value_exceeds_its_bounds_and_no_control_goes_both_ways(seed, size):
    bones = [bone(str(number), number, low=-0.1, high=0.15) for number in range(5)]
    bones += [bone(f"k{number}", number, low=-0.1, high=0.2, kink=number + 50) for number in range(5)]
    found = mapped(*bones)
    x = RigSolver(found).variables(effect(seed, size))
    assert (x >= found.lower - 1e-12).all() and (x <= found.upper + 1e-12).all()
    two = found.opposite >= 0
    assert not ((x > 0.0) & (x[found.opposite] > 0.0))[two].any()
    changes = found.values(x)
    assert (changes >= -0.1 - 1e-9).all() and (changes <= 0.2 + 1e-9).all()


def test_controls_that_move_nothing_do_not_keep_others_from_being_solved_for():
    found = mapped(*(bone(str(number), number) for number in range(4)))
    still = replace(found, effects=found.effects * np.array([1.0, 0.0, 0.0, 0.0])[:, None, None])
    solved = RigSolver(still).variables(0.5 * still.effects[0])
    np.testing.assert_allclose(solved, [0.5, 0.0, 0.0, 0.0], atol=0.05)
    assert not RigSolver(replace(found, effects=0.0 * found.effects)).variables(found.effects[0]).any()


def test_corrections_reach_what_the_linear_map_misses():
    found = mapped(*(bone(str(number), number) for number in range(4)))

    def rig(changes):
        x = changes / found.scale
        return np.einsum("k,ksc->sc", x + 0.3 * x**2, found.effects)

    wanted = rig(np.array([0.5, -0.4, 0.3, 0.6]) * found.scale)
    (once, first), (values, shown) = (RigSolver(found).corrected(wanted, rig, corrections) for corrections in (0, 2))
    np.testing.assert_array_equal(once, RigSolver(found).solve(wanted))
    np.testing.assert_array_equal(rig(values), shown)
    assert np.linalg.norm(shown - wanted) < 0.4 * np.linalg.norm(first - wanted)


@pytest.mark.parametrize("gain", [0.6, 1.0, 2.5])
def test_one_correction_brings_a_rig_nearer_that_moves_less_or_more_than_the_model_says(gain):
    found = mapped(*(bone(str(number), number) for number in range(4)))
    wanted = gain * np.einsum("k,ksc->sc", np.array([0.2, -0.1, 0.2, 0.15]), found.effects)
    solver = RigSolver(found)
    first = solver.variables(wanted)
    off = []
    for x in (first, solver.again(wanted, first, gain * np.einsum("k,ksc->sc", first, found.effects))):
        off.append(np.linalg.norm(gain * np.einsum("k,ksc->sc", x, found.effects) - wanted))
    assert off[1] < max(0.6 * off[0], 0.05 * np.linalg.norm(wanted))


def test_corrections_never_lead_away_from_a_face_that_the_model_does_not_foresee():
    found = mapped(*(bone(str(number), number) for number in range(4)))

    def rig(changes):
        x = changes / found.scale
        return np.einsum("k,ksc->sc", 4.0 * x, found.effects)

    wanted = rig(np.array([0.2, -0.1, 0.2, 0.15]) * found.scale)
    off = [np.linalg.norm(RigSolver(found).corrected(wanted, rig, n)[1] - wanted) for n in (0, 1, 2, 3)]
    assert off == sorted(off, reverse=True)


def test_of_controls_that_do_the_same_the_broad_one_is_preferred():
    broad, narrow = effect(1), effect(1).copy()
    narrow[66:] = 0.0
    narrow *= 0.5
    channels = [RigChannel("Rig", name, LOCATION, unit=UNIT) for name in ("broad", "narrow")]
    found = map_of(channels, [[Probe(0.1, broad)], [Probe(0.1, narrow)]], SAMPLE, UNIT)
    x = RigSolver(found).variables(broad)
    assert x[0] > 0.8 and x[1] < 0.3


def test_a_solution_is_pulled_towards_the_last_one():
    found = mapped(*(bone(str(number), number) for number in range(4)))
    solver, wanted = RigSolver(found), 0.5 * found.effects[0]
    first = solver.variables(wanted)
    again = solver.variables(wanted)
    assert again[0] >= first[0]
    solver.reset()
    np.testing.assert_array_equal(solver.variables(wanted), first)


def test_a_rig_without_controls_has_no_values():
    found = map_of([], [], SAMPLE, UNIT)
    assert found.controls == [] and RigSolver(found).solve(effect(1)).shape == (0,)


def test_the_share_that_a_rig_can_show_grows_with_its_controls():
    head = load_head()
    moved = UNIT / outer_eye_distance(head.vertices[head.landmarks]) * head.units[:, head.landmarks]
    every = [
        (RigChannel("Keys", "", PROPERTY, name=name, low=0.0, high=1.0), [Probe(1.0, own.astype(np.float64))])
        for name, own in zip(head.unit_names, moved, strict=True)
    ]
    few, many = (share_shown(map_of(*zip(*some, strict=True), SAMPLE[:66], UNIT)) for some in (every[:10], every))
    assert 0.0 < few < 0.5 < 0.9 < many <= 1.0


def test_a_map_survives_being_stored():
    turn = RigChannel("Rig", "jaw", ROTATION, 2, low=-0.2, rest=0.0)
    scale = RigChannel("Rig", "lip", SCALE, 1, low=-0.3, rest=1.0)
    others = ((turn, [Probe(0.1, effect(5))]), (scale, [Probe(0.5, effect(6)), Probe(-0.3, -0.6 * effect(6))]))
    found = mapped(bone("a", 1, low=-0.1), bone("b", 2, kink=9), *others)
    stored = from_bytes(to_bytes(found, RIG, ["Rig"]))
    again = stored.found
    assert stored.rig == RIG and stored.owners == ("Rig",) and again.channels == found.channels
    np.testing.assert_array_equal(again.channel, found.channel)
    np.testing.assert_allclose(again.effects, found.effects, atol=1e-4 * UNIT)
    for name in ("scale", "lower", "upper", "doubt"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 255), st.booleans())
def test_damaged_bytes_are_an_error_or_a_sound_map(place, value, cut):
    data = bytearray(to_bytes(mapped(bone("a", 1), bone("b", 2)), RIG, ["Rig"]))
    place %= len(data)
    data[place] = value
    try:
        found = from_bytes(bytes(data[:place] if cut else data)).found
    except SourceError as error:
        assert "Learn the controls again" in str(error)
    else:
        assert (found.lower < found.upper).all() and np.isfinite(found.effects).all()
