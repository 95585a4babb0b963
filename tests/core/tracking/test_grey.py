"""Images that are converted to grey where they are looked at."""

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.tracking.grey import GreyImage, region, whole

HEIGHT, WIDTH = 37, 53
IMAGE = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
GREY = cv2.cvtColor(IMAGE, cv2.COLOR_BGR2GRAY)


def _spans(length: int) -> st.SearchStrategy:
    return st.lists(st.integers(0, length), min_size=2, max_size=2, unique=True).map(sorted)


@given(st.lists(st.tuples(_spans(WIDTH), _spans(HEIGHT)), max_size=6))
def test_regions_are_those_of_the_whole_image_in_grey_in_any_order(boxes):
    image = GreyImage(IMAGE)
    for (left, right), (top, bottom) in boxes:
        np.testing.assert_array_equal(region(image, left, top, right, bottom), GREY[top:bottom, left:right])
    np.testing.assert_array_equal(whole(image), GREY)


def test_an_image_that_is_grey_is_used_as_it_is():
    assert whole(GREY) is GREY
    assert np.shares_memory(region(GREY, 3, 4, 10, 12), GREY)
