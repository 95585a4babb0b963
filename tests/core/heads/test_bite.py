"""The angle by which lower teeth rise until they meet the upper ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.heads.bite import bite_between, bite_of
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import FaceParts, Part, built_in_head

HINGE = np.array([0.0, 0.0, 1.0])


def row(first: float, last: float) -> np.ndarray:
    """An arch of teeth between two heights, one outer-eye distance in front of the hinge."""
    x, y = (values.ravel() for values in np.meshgrid(np.linspace(-0.2, 0.2, 21), np.linspace(first, last, 5)))
    return np.column_stack([x, y, 4.0 * x * x]).astype(np.float32)


@given(st.floats(0.0, 0.08), st.floats(0.01, 100.0))
def test_teeth_that_have_turned_by_it_overlap_by_a_hundredth(gap: float, unit: float) -> None:
    upper, lower = row(-0.1, 0.0) * unit, row(gap, gap + 0.1) * unit
    angle = bite_between(upper, lower, HINGE * unit, unit)
    risen = lower[:, 1] - np.sin(angle) * (HINGE[2] * unit - lower[:, 2])
    front = np.abs(lower[:, 0]) < 0.05 * unit
    assert risen[front].min() / unit == pytest.approx(-0.01, abs=0.004)


def test_teeth_that_overlap_at_rest_stay() -> None:
    assert bite_between(row(-0.1, 0.0), row(-0.02, 0.1), HINGE, 1.0) == 0.0


def test_a_missing_row_of_teeth_meets_nothing() -> None:
    assert bite_between(row(-0.1, 0.0), row(0.0, 0.1)[:0], HINGE, 1.0) == 0.0
    assert bite_between(row(-0.1, 0.0)[:0], row(0.0, 0.1), HINGE, 1.0) == 0.0


def test_teeth_far_below_do_not_rise_more_than_a_tenth() -> None:
    assert bite_between(row(-0.1, 0.0), row(0.5, 0.6), HINGE, 1.0) == pytest.approx(0.1, rel=0.1)


def test_the_teeth_of_the_built_in_heads_which_their_rigs_lack_are_known() -> None:
    assert bite_of(built_in_head()) == bite_of(built_in_head(lashes=True)) > 0.0


def test_teeth_of_a_rig_without_upper_ones_rise_to_the_upper_lip() -> None:
    head, rig = load_head(), built_in_head()
    teeth = head.part("teeth_lower")
    kinds = np.repeat([Part.SKIN, Part.TEETH_LOWER], [len(head.vertices), len(teeth.vertices)]).astype(np.int8)
    faces = np.where(teeth.faces < 0, -1, teeth.faces + len(head.vertices))
    alone = replace(rig, parts=FaceParts(kinds, teeth.vertices, faces))
    assert bite_of(alone) == pytest.approx(bite_of(rig), rel=0.2)
