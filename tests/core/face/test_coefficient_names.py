"""Programs name ARKit's coefficients in many ways, and divide some of them."""

import pytest

from facemime.core.face.names import COEFFICIENT_INDEX, column_of, combined


@pytest.mark.parametrize("name", ["browInnerUp", "cheekPuff", "jawOpen", "mouthFunnel"])
@pytest.mark.parametrize("spelling", ["{}_L", "{}Left", "{}.R", "blendShapes.{}_r"])
def test_halves_of_a_coefficient_without_sides_are_known(name, spelling):
    assert column_of(spelling.format(name)) == COEFFICIENT_INDEX[name]


@pytest.mark.parametrize("name", ["jawLeft", "jawRight", "mouthLeft", "mouthRight"])
def test_coefficients_that_are_named_after_a_direction_are_no_halves(name):
    assert column_of(name) == COEFFICIENT_INDEX[name]


@pytest.mark.parametrize("name", ["mouth_L_corner", "left", "brow", "jawOpenerLeft", ""])
def test_other_names_are_not_known(name):
    assert column_of(name) is None


@pytest.mark.parametrize(
    ("values", "whole"),
    [
        ([("browInnerUp_L", 0.8), ("browInnerUp_R", 0.4)], 0.6),
        ([("browInnerUpLeft", 0.8)], 0.8),
        ([("browInnerUp", 0.0), ("browInnerUp_L", 0.8), ("browInnerUp_R", 0.4)], 0.6),
        ([("browInnerUp", 0.7), ("browInnerUp_L", 0.0), ("browInnerUp_R", 0.0)], 0.7),
        ([("BrowInnerUp", 0.7), ("browInnerUp", 0.002)], 0.7),
        ([("browInnerUp", 0.002), ("BrowInnerUp", 0.7), ("Unknown", 1.0)], 0.7),
    ],
)
def test_halves_are_averaged_and_the_larger_of_two_spellings_counts(values, whole):
    assert combined(values) == {COEFFICIENT_INDEX["browInnerUp"]: pytest.approx(whole)}
