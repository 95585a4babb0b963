"""Several senders to one port drive several heads."""

import threading
import time

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.face.names import COEFFICIENT_INDEX, N_COEFFICIENTS
from facemime.core.streams.sender import StreamSender
from facemime.core.streams.stream_settings import SendSettings
from facemime.core.takes.measured import coefficient_face
from facemime.operators.puppet import running
from facemime.settings import takes_store
from tests.helpers.links import free_port
from tests.helpers.live_ticks import shown, start, ticks_until

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def phones():
    """Two phones that keep sending on one port, and whose names can be added to the senders."""
    source, port, over = bpy.context.scene.facemime.source, free_port(), threading.Event()
    source.kind, source.stream.protocol, source.stream.port = "STREAM", "livelink", port
    bpy.context.scene.facemime.smoothing = 0.0
    levels = {"Ada": 0.8, "Ben": 0.3}
    senders = {name: StreamSender(SendSettings("livelink", port=port, subject=name)) for name in levels}
    sending = {"Ada"}

    def send() -> None:
        began = time.monotonic()
        while not over.wait(1.0 / 60.0):
            for name in sorted(sending):
                coefficients = np.zeros(N_COEFFICIENTS)
                coefficients[COEFFICIENT_INDEX["jawOpen"]] = levels[name]
                result = coefficient_face().result(coefficients, np.zeros(3), None)
                senders[name].send(time.monotonic() - began, result, coefficient_face().neutral)

    thread = threading.Thread(target=send)
    thread.start()
    yield sending
    over.set()
    thread.join()
    for sender in senders.values():
        sender.close()


def two_heads() -> list[bpy.types.Object]:
    """Two selected heads, the first of them active."""
    heads = [add_head(bpy.context), add_head(bpy.context)]
    for head in heads:
        head.select_set(True)
    bpy.context.view_layer.objects.active = heads[0]
    return heads


def jaws(heads) -> list[float]:
    """Largest distance in metres that each head has moved from rest."""
    return [float(np.abs(shown(head) - [vertex.co for vertex in head.data.vertices]).max()) for head in heads]


def test_two_senders_drive_two_heads(phones):
    heads = two_heads()
    start()
    ticks_until(lambda: min(jaws(heads)) > 1e-3)
    assert jaws(heads)[0] == pytest.approx(jaws(heads)[1], rel=1e-3)
    phones.add("Ben")
    ticks_until(lambda: jaws(heads)[1] < 0.6 * jaws(heads)[0])
    source = running().worker.source
    assert source.driven == {"127.0.0.1 Ada": (0,), "127.0.0.1 Ben": (1,)}
    assert jaws(heads)[0] > 1e-3 and jaws(heads)[1] > 1e-4
    bpy.ops.facemime.stop_puppet()


def test_each_head_of_a_running_puppet_can_be_given_its_own_sender(phones):
    phones.add("Ben")
    heads = two_heads()
    heads[0].facemime.sender, heads[1].facemime.sender = "Ben", "Ada"
    start()
    ticks_until(lambda: 1e-4 < jaws(heads)[0] < 0.6 * jaws(heads)[1])
    heads[0].facemime.sender, heads[1].facemime.sender = "127.0.0.1 Ada", "Ben"
    ticks_until(lambda: 1e-4 < jaws(heads)[1] < 0.6 * jaws(heads)[0])
    heads[1].facemime.sender = "Ada"
    ticks_until(lambda: jaws(heads)[0] > 1e-3 and abs(jaws(heads)[1] / jaws(heads)[0] - 1.0) < 1e-3)
    bpy.ops.facemime.stop_puppet()


def test_two_senders_are_recorded_as_two_takes_at_the_same_times(phones, takes):
    phones.add("Ben")
    heads = two_heads()
    start()
    ticks_until(lambda: min(jaws(heads)) > 1e-4 and len(running().worker.source.senders) == 2)
    takes.countdown = "0"
    assert bpy.ops.facemime.record_take(name="Scene") == {"FINISHED"}
    ticks_until(lambda: running().recorder.recording.frames > 30)
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    bpy.ops.facemime.stop_puppet()
    recorded = {item.name: takes_store.read(item) for item in takes.items}
    assert len(recorded) == 2
    jaw = COEFFICIENT_INDEX["jawOpen"]
    by_sender = {take.info["sender"]: take for take in recorded.values()}
    assert set(by_sender) == {"127.0.0.1 Ada", "127.0.0.1 Ben"}
    for sender, level in (("127.0.0.1 Ada", 0.8), ("127.0.0.1 Ben", 0.3)):
        np.testing.assert_allclose(by_sender[sender].coefficients[:, jaw], level, atol=1e-4)
    first, last = (np.array([take.times[end] for take in recorded.values()]) for end in (0, -1))
    gap = max(np.diff(take.times).max() for take in recorded.values())  # long on a busy machine
    assert first.min() == 0.0 and np.ptp(first) < max(0.1, 2 * gap) and np.ptp(last) < max(0.1, 2 * gap)
    assert any(bpy.path.clean_name(heads[1].name) in name for name in recorded)
