"""Selection of control points for a head from a take, and landmarks as users list them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..deform.head_deformer import INFORMED
from ..drive.retarget import retargeter_for
from ..errors import DataError, HeadError
from ..face.landmarks import IBUG68_INDICES, from_ibug
from ..heads.rig import HeadRig
from ..takes.neutral import Neutral, calibrate
from ..takes.take import Take
from .greedy import greedy_select
from .selection import GreedySelection, Search, SelectionSettings

_LEFT_OUT = frozenset(range(68)) - frozenset(IBUG68_INDICES.tolist())
_LAST = int(IBUG68_INDICES[-1])
_BEYOND = 68


def select_control_points(
    rig: HeadRig,
    take: Take,
    *,
    neutral: Neutral | None = None,
    tolerance: float = SelectionSettings.tolerance,
    max_points: int = SelectionSettings.max_points,
    always: Iterable[int] = (),
    never: Iterable[int] = (),
    search: Search = SelectionSettings.search,
    kernel: str | None = None,
) -> GreedySelection:
    """Select the control points that a head needs for a take.

    Parameters
    ----------
    rig : HeadRig
        The head.
    take : Take
        The take.
    neutral : Neutral, optional
        The performer's neutral face; by default it is found in the take.
    tolerance : float
        As for `greedy_select`.
    max_points : int
        As for `greedy_select`.
    always, never : iterable of int
        As for `greedy_select`.
    search : {"take", "paper"}
        As for `greedy_select`.
    kernel : str, optional
        As in `DriveSettings`; by default that of the search.

    Returns
    -------
    GreedySelection
        The selection; frames are numbered as in the take.

    Raises
    ------
    SourceError
        If the take has no face.

    Examples
    --------
    >>> from facemime import built_in_head, load_take, select_control_points
    >>> selection = select_control_points(built_in_head(), load_take("performance.facetake"), tolerance=0.02)
    >>> selection.membership.shape
    (3, 66)
    """
    neutral = calibrate(take) if neutral is None else neutral
    landmarks = np.asarray(rig.vertices, dtype=np.float64)[rig.landmarks]
    retargeter = retargeter_for(neutral, landmarks)
    found = np.flatnonzero(take.found)
    motion = retargeter.displacements(take.shape[found], take.teeth[found])
    selection = greedy_select(
        landmarks,
        motion,
        tolerance=tolerance,
        max_points=max_points,
        always=always,
        never=never,
        search=search,
        kernel=None if kernel == INFORMED else kernel,
        skin=(rig.vertices, rig.region_weights),
    )
    return replace(selection, steps=tuple(replace(step, frame=int(found[step.frame])) for step in selection.steps))


def parse_landmarks(text: str) -> list[int]:
    """Parse iBUG numbers and ranges such as "17,19-21" as positions in the 66 landmarks; an empty text gives none.

    Ranges skip 60 and 64, which are not among the 66 landmarks. Raises HeadError if the text is anything else.
    """
    numbers: list[int] = []
    try:
        for part in filter(None, (part.strip() for part in text.split(","))):
            first, dash, last = part.partition("-")
            span = range(int(first), min(int(last or first), _BEYOND) + 1)
            if not span:
                raise DataError("{part} is reversed", part=part)
            if not 0 <= span[0] <= span[-1] <= _LAST:  # before a long range is expanded in memory
                raise DataError("landmarks are numbered from 0 to {last}", last=_LAST)
            numbers += [number for number in span if not dash or number not in _LEFT_OUT]
        return [int(i) for i in from_ibug(numbers)]
    except ValueError as error:
        raise HeadError(
            "{text!r} is not a list of landmarks ({error}). Use iBUG numbers such as 17,19-21.", text=text, error=error
        ) from error
