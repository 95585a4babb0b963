"""Who of several people in view drives which head."""

from __future__ import annotations

from collections.abc import Collection, Sequence

_AWAITED = 5.0
"""Seconds for which a head waits for its person before somebody else may drive it."""


class PeopleRoles:
    """Assigns people to heads: those that were chosen, and otherwise whoever appears first and drives no head yet.

    Examples
    --------
    >>> from facemime.core.puppet.roles import PeopleRoles
    >>> roles = PeopleRoles()
    >>> roles.assign((0, 0), {0}, 0.0), roles.assign((0, 0), {0, 1}, 0.1)
    ({0: (0,)}, {0: (0,), 1: (1,)})
    >>> roles.assign((2, 0), {0, 1}, 0.2)  # the first head follows the second person
    {1: (0,), 0: (1,)}
    """

    def __init__(self) -> None:
        self._roles: dict[int, int] = {}
        self._seen: dict[int, float] = {}

    def assign(self, wanted: Sequence[int], in_view: Collection[int], time: float) -> dict[int, tuple[int, ...]]:
        """Assign the people in view, and return the heads of each person who drives some, whether in view or not.

        For each head, `wanted` is the number of its person from 1, or 0 for anybody; `in_view` are numbers from 0. Time
        is in seconds.
        """
        self._seen.update(dict.fromkeys(in_view, time))
        chosen = {head: person - 1 for head, person in enumerate(wanted) if person > 0}
        kept = {
            head: person
            for head, person in self._roles.items()
            if head < len(wanted)
            and person not in chosen.values()
            and time - self._seen.get(person, -_AWAITED) < _AWAITED
        }
        self._roles = kept | chosen
        free = sorted(set(in_view) - set(self._roles.values()))
        for head in range(len(wanted)):
            if head not in self._roles and free:
                self._roles[head] = free.pop(0)
        heads: dict[int, tuple[int, ...]] = {}
        for head, person in sorted(self._roles.items()):
            heads[person] = (*heads.get(person, ()), head)
        return heads
