"""Two heads follow two people of one video."""

from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.files.capture import read_image
from facemime.core.tracking.tracker import FaceTracker
from facemime.operators.puppet import running
from facemime.settings import takes_store
from facemime.ui.puppet import FACEMIME_PT_puppet
from facemime.ui.source import FACEMIME_PT_source
from tests.helpers.live_ticks import start, ticks_until
from tests.helpers.panels import draw

pytestmark = pytest.mark.usefixtures("nothing_left_over")
PORTRAITS = Path(__file__).parents[1] / "data" / "portraits"
SIDE = 300


@pytest.fixture(scope="module")
def couple(tmp_path_factory):
    """A video of two people side by side."""
    tracker, sides = FaceTracker.load(), []
    for name in ("collins.jpg", "hopper.jpg"):
        image = read_image(PORTRAITS / name)
        pose = tracker.locate(image).pose
        matrix = np.column_stack([70.0 / pose[0] * np.eye(2), SIDE / 2.0 - 70.0 / pose[0] * pose[4:6]])
        sides.append(cv2.warpAffine(image, matrix, (SIDE, SIDE), borderMode=cv2.BORDER_REPLICATE))
    path = tmp_path_factory.mktemp("video") / "couple.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25.0, (2 * SIDE, SIDE))
    for frame in range(50):
        writer.write(np.roll(np.hstack(sides), frame % 2, axis=0))
    writer.release()
    return path


@pytest.fixture
def heads(couple):
    """Two selected heads, whose source is the video."""
    heads = [add_head(bpy.context) for _ in range(2)]
    for head in heads:
        head.select_set(True)
    source = bpy.context.scene.facemime.source
    source.kind, source.video, source.face = "VIDEO", str(couple), "ALL"
    return heads


def test_two_heads_follow_two_people_and_can_change_places(heads):
    start()
    ticks_until(lambda: running().shown is not None and len(running().shown.people) == 2)
    ticks_until(lambda: running().shown.people == {0: (0,), 1: (1,)})
    first = running().heads[0].obj
    first.facemime.person = 2
    ticks_until(lambda: running().shown.people == {0: (1,), 1: (0,)})
    first.facemime.person = 0
    bpy.context.scene.facemime.source.face = "LARGEST"
    ticks_until(lambda: not running().shown.people)
    bpy.ops.facemime.stop_puppet()


def test_the_panels_list_who_is_in_view_and_who_drives_each_head(heads):
    assert draw(FACEMIME_PT_source).count("person") == 2
    start()
    ticks_until(lambda: running().shown is not None and len(running().shown.people) == 2)
    shown = draw(FACEMIME_PT_puppet)
    for number, head in enumerate(running().heads, start=1):
        assert f"Person {number}: {head.obj.name}" in shown
    bpy.context.scene.facemime.source.face = "LARGEST"
    assert "person" not in draw(FACEMIME_PT_source)
    bpy.ops.facemime.stop_puppet()


def test_two_people_are_recorded_as_two_takes(heads, takes):
    start()
    ticks_until(lambda: running().shown is not None and len(running().shown.people) == 2)
    takes.countdown = "0"
    assert bpy.ops.facemime.record_take(name="Scene") == {"FINISHED"}
    ticks_until(lambda: running().recorder.recording.frames > 30)
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    bpy.ops.facemime.stop_puppet()
    made = [takes_store.read(item) for item in takes.items]
    assert len(made) == 2 and {take.info["sender"] for take in made} == {"Person 1", "Person 2"}
    sides = {int(np.median(take.pose[take.found, 4]) // SIDE) for take in made}
    assert sides == {0, 1}
