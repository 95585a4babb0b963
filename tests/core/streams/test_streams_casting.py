"""Assignment of several senders to heads."""

from facemime.core.streams.casting import SILENT, Casting

ADA, BEN, CAT = ((("10.0.0.1", 1), "Ada"), (("10.0.0.1", 1), "Ben"), (("10.0.0.2", 1), "Cat"))


def cast(casting: Casting) -> dict:
    """Return the heads that each face drives."""
    return {role.followed: role.heads for role in casting.roles if role.heads}


def test_the_first_sender_drives_every_head_until_others_come():
    casting = Casting(("", "", ""))
    casting.update({ADA: 0.0}, 0.0)
    assert cast(casting) == {ADA: (0, 1, 2)}
    casting.update({ADA: 1.0, BEN: 1.0}, 1.0)
    assert cast(casting) == {ADA: (0, 2), BEN: (1,)}
    casting.update({ADA: 2.0, BEN: 2.0, CAT: 2.0}, 2.0)
    assert cast(casting) == {ADA: (0,), BEN: (1,), CAT: (2,)}


def test_a_single_head_follows_the_first_sender_until_it_ends():
    casting = Casting()
    casting.update({ADA: 0.0, BEN: 0.1}, 0.1)
    casting.update({ADA: 0.0, BEN: SILENT}, SILENT)
    assert cast(casting) == {ADA: (0,)}
    casting.update({ADA: 0.0, BEN: SILENT + 0.2}, SILENT + 0.2)
    assert cast(casting) == {BEN: (0,)}


def test_an_interruption_of_the_network_changes_nothing():
    casting = Casting(("", ""))
    casting.update({ADA: 0.0, BEN: 0.0}, 0.0)
    before = cast(casting)
    casting.update({ADA: 0.0, BEN: 0.0}, 60.0)
    casting.update({ADA: 0.0, BEN: 61.0}, 61.0)
    casting.update({ADA: 61.1, BEN: 61.1}, 61.1)
    assert cast(casting) == before == {ADA: (0,), BEN: (1,)}


def test_a_restarted_sender_takes_its_own_head_rather_than_the_next():
    again = (("10.0.0.1", 2), "Ada")
    casting = Casting(("", ""))
    casting.update({ADA: 0.0}, 0.0)
    for now in (0.8, 1.5, SILENT + 0.5):
        casting.update({ADA: 0.0, again: now}, now)
    assert cast(casting) == {again: (0, 1)}


def test_a_choice_is_by_address_by_name_or_by_both():
    for wanted in ("10.0.0.2", "Cat", "10.0.0.2 Cat"):
        casting = Casting((wanted, ""))
        casting.update({ADA: 0.0}, 0.0)
        assert cast(casting) == {None: (0,), ADA: (1,)}
        casting.update({ADA: 0.1, CAT: 0.1}, 0.1)
        assert cast(casting) == {CAT: (0,), ADA: (1,)}


def test_the_more_exact_choice_has_precedence():
    casting = Casting(("10.0.0.1", "Ada"))
    casting.update({ADA: 0.0, BEN: 0.0}, 0.0)
    assert cast(casting) == {BEN: (0,), ADA: (1,)}


def test_heads_with_the_same_sender_move_together():
    casting = Casting(("Ada", "10.0.0.1 Ada", "Ada", "Ben"))
    casting.update({ADA: 0.0, BEN: 0.0}, 0.0)
    assert {name: sorted(heads) for name, heads in cast(casting).items()} == {ADA: [0, 1, 2], BEN: [3]}


def test_a_performer_keeps_its_number_when_other_choices_change():
    casting = Casting(("", ""))
    casting.update({ADA: 0.0, BEN: 0.0}, 0.0)
    numbers = {role.followed: role.number for role in casting.roles}
    casting.choose(("Ben", "Ada"))
    casting.update({ADA: 0.1, BEN: 0.1}, 0.1)
    assert cast(casting) == {BEN: (0,), ADA: (1,)}
    assert {role.followed: role.number for role in casting.roles} == numbers


def test_performers_share_one_time_scale():
    casting = Casting(("", ""))
    assert [casting.start_of(due) for due in (100.0, 107.5, 99.9)] == [0.0, 7.5, 0.0]
