"""The stage reported as the slowest is the one that limits the rate."""

from facemime.core.puppet.timing import REDRAW, STAGES, Delays, Stopwatch


def watched(redraw: float, **stages: float) -> Stopwatch:
    watch = Stopwatch()
    for _ in range(10):
        watch.add(Delays(tuple(stages.get(name, 1e-4) for name in STAGES)))
        watch.add_redraw(redraw)
    return watch


def test_tracking_is_named_while_blender_redraws_quickly():
    assert watched(0.003, track=0.02).slowest() == "track"


def test_the_viewport_is_named_when_its_redraw_takes_longer_than_any_stage():
    watch = watched(0.5, track=0.02)
    assert watch.slowest() == REDRAW and watch.redraw == 0.5
    assert REDRAW not in watch.medians()


def test_nothing_is_named_when_all_is_fast():
    assert watched(0.001).slowest() == "" and Stopwatch().slowest() == ""
