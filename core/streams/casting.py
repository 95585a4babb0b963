"""Assignment of senders to heads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .playout import HOLD, Timeline

SILENT = 2.0
"""Seconds without a packet after which another sender may be followed."""
Address = tuple[str, int]
FaceName = tuple[Address, str]
"""Address that a face is sent from, and its name."""
_NOBODY, _ANYBODY, _ADDRESS, _SUBJECT, _BOTH = range(-1, 4)


def label_of(name: FaceName) -> str:
    """Return the name of a face in the interface: the address, and its name if it has one."""
    address, subject = name
    return f"{address[0]} {subject}".strip()


@dataclass
class Role:
    """What one sender drives.

    Attributes
    ----------
    wanted : str
        Address or name of the sender; "" for the next one that comes.
    number : int
        Number of the performer, which is the same as long as the same sender is followed.
    timeline : Timeline
        Times of the performer's frames.
    own : tuple of int
        Heads that no other sender may drive while this one is there.
    heads : tuple of int
        Heads that are driven now.
    followed : FaceName or None
        The face that is followed now.
    """

    wanted: str
    number: int
    timeline: Timeline
    own: tuple[int, ...]
    heads: tuple[int, ...] = ()
    followed: FaceName | None = None


class Casting:
    """Assigns a sender to each head; `roles` are what each sender drives.

    A head follows the sender whose address or name is `wanted` for it. Of the other heads, for which it is "", the
    first follows the first sender that comes, the second the second, and so on; while there are fewer senders, the
    first one drives the remaining heads.
    """

    def __init__(self, wanted: tuple[str, ...] = ("",)) -> None:
        self.roles: list[Role] = []
        self._wanted: tuple[str, ...] = ()
        self._origin: float | None = None
        self._numbers = 0
        self.choose(wanted)

    def choose(self, wanted: tuple[str, ...]) -> None:
        """Choose other senders. A sender that is followed and still wanted keeps its number and its times."""
        if wanted == self._wanted:
            return
        self._wanted = wanted
        heads = _heads_by_choice(wanted)
        before, self.roles = self.roles, []
        for name, own in heads:
            kept = next((role for role in before if _fits(role, name)), None)
            if kept is None:
                kept = Role(name, self._numbers, Timeline(), ())
                self._numbers += 1
            else:
                before.remove(kept)
            kept.wanted, kept.own = name, own
            self.roles.append(kept)
        self._share()

    def update(self, heard: Mapping[FaceName, float], now: float) -> None:
        """Follow the senders that are there; `heard` says when each face last came, in seconds and order of arrival."""
        waiting = False
        for role in self.roles:
            if role.followed not in heard:
                role.followed = None
            if waiting and not role.wanted and role.followed is None:
                continue
            self._follow(role, heard, now)
            silent = role.followed is None or now - heard.get(role.followed, -SILENT) > HOLD
            waiting = waiting or (not role.wanted and silent)
        self._share()

    def start_of(self, due: float) -> float:
        """Return the start time of a performer whose first frame is due at `due`; 0 for the first performer."""
        self._origin = due if self._origin is None else self._origin
        return max(due - self._origin, 0.0)

    def _follow(self, role: Role, heard: Mapping[FaceName, float], now: float) -> None:
        taken = [other.followed for other in self.roles if other is not role]
        known = {name: when for name, when in heard.items() if self._may_follow(role, name) and name not in taken}
        last = None if role.followed is None else known.get(role.followed)
        if last is not None and now - last <= SILENT:
            return
        there = {name: when for name, when in known.items() if now - when <= SILENT}
        if role.followed is None:
            role.followed = next(iter(there), None)
            return
        newest = max(there, key=lambda name: there[name], default=None)
        if newest is not None and (last is None or there[newest] > last + SILENT):
            role.followed = newest

    def _may_follow(self, role: Role, name: FaceName) -> bool:
        levels = [_match(other.wanted, name) for other in self.roles]
        return _match(role.wanted, name) == max(levels) > _NOBODY

    def _share(self) -> None:
        """Leave heads without their own sender to the role whose sender may drive them, too."""
        for role in self.roles:
            role.heads = role.own
        for role in self.roles:
            host = None if role.followed is not None else self._host_of(role)
            if host is not None:
                host.heads, role.heads = host.heads + role.own, ()

    def _host_of(self, role: Role) -> Role | None:
        if not role.wanted:
            first = next(other for other in self.roles if not other.wanted)
            return None if first is role else first
        named = (other for other in self.roles if other.followed is not None)
        return next((other for other in named if _match(role.wanted, other.followed) > _ANYBODY), None)


def _heads_by_choice(wanted: tuple[str, ...]) -> list[tuple[str, tuple[int, ...]]]:
    """Return the heads that one sender drives: all with the same choice, or one without a choice."""
    chosen: dict[str, tuple[int, ...]] = {}
    heads: list[tuple[str, tuple[int, ...]]] = []
    for number, name in enumerate(wanted):
        if name in chosen:
            chosen[name] += (number,)
        elif name:
            chosen[name] = (number,)
        if not name:
            heads.append(("", (number,)))
    return sorted([*heads, *chosen.items()], key=lambda entry: entry[1])


def _fits(role: Role, wanted: str) -> bool:
    """Return whether an earlier role can continue as one with the choice `wanted`."""
    if role.followed is None:
        return role.wanted == wanted
    return role.wanted == wanted or _match(wanted, role.followed) > _ANYBODY


def _match(wanted: str, name: FaceName | None) -> int:
    """Rank how exactly a choice names a face."""
    if name is None:
        return _NOBODY
    address, subject = name
    means = {label_of(name): _BOTH, subject: _SUBJECT, address[0]: _ADDRESS, "": _ANYBODY}
    return means.get(wanted, _NOBODY)
