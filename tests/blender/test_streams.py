"""Streams in Blender: as the source of a puppet, as its output, and kept off the network unless that is allowed."""

import socket
import threading
import time
from contextlib import closing
from dataclasses import replace

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import PART_PROPERTY
from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.errors import SourceError
from facemime.core.face.names import COEFFICIENT_INDEX
from facemime.core.streams.protocols.live_link import LiveLinkDecoder
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import StreamSettings
from facemime.core.streams.transport.addresses import Pairing, parse_pairing
from facemime.core.streams.transport.security import load_identity
from facemime.core.streams.transport.tls_server import TlsSender
from facemime.core.streams.vertices import VertexSender
from facemime.core.takes.coefficient_table import write_coefficient_csv
from facemime.core.takes.neutral import calibrate
from facemime.operators.puppet import running
from facemime.settings import takes_store
from facemime.settings.performers import read_calibration, write_calibration
from facemime.settings.preferences import preferences
from facemime.settings.properties import pairing_line
from facemime.settings.values import open_sender, open_source
from facemime.ui.puppet import FACEMIME_PT_incoming, FACEMIME_PT_puppet
from tests.helpers.links import all_the_time, free_port, performing, sending_phone
from tests.helpers.live_ticks import shown, some_frames, start, tick, ticks_until
from tests.helpers.panels import draw
from tests.helpers.takes import coefficient_take, performance
from tests.helpers.viewer.watching import built_in, face
from tests.helpers.vtube_studio import TOKEN, Studio
from tests.helpers.vtube_studio import running as at_port

pytestmark = pytest.mark.usefixtures("nothing_left_over")


@pytest.fixture
def phone():
    """A stream of Live Link Face as the source, and a sender that keeps sending."""
    source, port = bpy.context.scene.facemime.source, free_port()
    source.kind, source.stream.protocol, source.stream.port = "STREAM", "livelink", port
    bpy.context.scene.facemime.smoothing = 0.0
    with sending_phone(port) as take:
        yield take


@pytest.fixture
def online():
    """Blender's switch for online access, off, and restored afterwards."""
    system = bpy.context.preferences.system
    before, system.use_online_access = system.use_online_access, False
    assert not bpy.app.online_access
    yield system
    system.use_online_access = before


def test_a_phone_drives_a_head_with_its_own_neutral_face(phone):
    head = add_head(bpy.context)
    rest = shown(head)
    start()
    ticks_until(lambda: np.abs(shown(head) - rest).max() > 0.005)
    session = running()
    assert session.worker.first.neutral.measured and session.worker.source.senders == ("127.0.0.1 Phone",)
    assert bpy.ops.facemime.stop_puppet() == {"FINISHED"}
    np.testing.assert_allclose(shown(head), rest, atol=1e-6)


def test_the_values_of_a_phone_are_shown_while_it_drives_a_head(phone):
    add_head(bpy.context)
    assert not FACEMIME_PT_incoming.poll(bpy.context)
    start()
    ticks_until(lambda: running().worker.source.incoming)
    drawn = draw(FACEMIME_PT_incoming)
    assert FACEMIME_PT_incoming.poll(bpy.context) and "127.0.0.1 Phone" in drawn and "mouthSmileLeft" in drawn


def test_another_protocol_is_named_in_the_panel(phone):
    bpy.context.scene.facemime.source.stream.protocol = "vmc"
    add_head(bpy.context)
    assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
    ticks_until(lambda: running().worker.message)
    assert "looks like Live Link Face, not VMC" in draw(FACEMIME_PT_puppet)


def test_moved_vertices_drive_a_head_with_their_own_rest_as_the_neutral_face():
    source, port = bpy.context.scene.facemime.source, free_port()
    source.kind, source.stream.protocol, source.stream.port = "STREAM", "vertices", port
    head = add_head(bpy.context)
    rest = shown(head)
    driver, looks = built_in()
    moved = driver.frame(face(jawOpen=0.8))
    with (
        VertexSender("127.0.0.1", port, [looks]) as sender,
        all_the_time(lambda seconds: sender.show(seconds, [driver], [moved])),
    ):
        start()
        ticks_until(lambda: np.abs(shown(head) - rest).max() > 0.015)
    assert running().worker.first.neutral.measured
    assert bpy.ops.facemime.stop_puppet() == {"FINISHED"}


def test_a_calibration_of_a_phone_is_not_kept_for_the_camera(phone):
    add_head(bpy.context)
    settings = bpy.context.scene.facemime
    settings.source.loop = True
    write_calibration(settings, replace(calibrate(performance()), asked=True))
    before = read_calibration(settings)
    start()
    assert running().worker.first.neutral.measured
    assert bpy.ops.facemime.calibrate(countdown=0.05) == {"FINISHED"}
    ticks_until(lambda: running().countdown is None and running().worker.first.quality is not None)
    assert running().worker.first.neutral.measured
    bpy.ops.facemime.stop_puppet()
    np.testing.assert_array_equal(read_calibration(settings).shape, before.shape)


def test_a_recorded_phone_bakes_to_the_sent_values(phone, takes):
    add_head(bpy.context)
    source = bpy.context.scene.facemime.source.stream
    assert source.protocol == "livelink"
    takes.countdown = "0"
    start()
    assert bpy.ops.facemime.record_take(name="Phone") == {"FINISHED"}
    ticks_until(lambda: running().recorder.recording.frames > 40)
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    bpy.ops.facemime.stop_puppet()
    take = takes_store.read(takes.items[0])
    assert take.info["measured"]
    found = arkit_coefficients(take, calibrate(take))
    off = [np.abs(phone.coefficients - row).max(axis=1).min() for row in found]
    assert max(off) < 2e-5


def test_keys_are_driven_by_the_values_themselves(phone):
    head = add_head(bpy.context, units=True)
    for child in [child for child in head.children if PART_PROPERTY in child]:
        bpy.data.objects.remove(child)
    bpy.context.scene.facemime.drive_by = "KEYS"
    start()
    some_frames()
    session = running()
    values = session.shown.result.coefficients
    keys = session.worker.heads[0].keys
    wanted = sum(values[COEFFICIENT_INDEX[name]] * offsets for name, offsets in keys.offsets.items())
    moved = session.shown.heads[0].vertices - session.worker.heads[0].rig.all_vertices
    np.testing.assert_allclose(moved, wanted, atol=1e-6)
    bpy.ops.facemime.stop_puppet()


def test_a_table_of_live_link_face_is_imported_into_the_list(takes, tmp_path):
    sent = coefficient_take(30)
    path = tmp_path / "MySlate.csv"
    write_coefficient_csv(path, sent.times, sent.coefficients, sent.pose[:, 1:4], live_link=True)
    assert bpy.ops.facemime.import_take(filepath=str(path)) == {"FINISHED"}
    take = takes_store.read(takes.items[0])
    np.testing.assert_allclose(arkit_coefficients(take, calibrate(take)), sent.coefficients, atol=2e-5)


def test_tracked_faces_are_sent_while_the_puppet_runs(take):
    add_head(bpy.context)
    settings = bpy.context.scene.facemime
    settings.source.loop = True
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unreal:
        unreal.bind(("127.0.0.1", 0))
        unreal.settimeout(60.0)
        output = settings.output
        output.enabled, output.protocol, output.port, output.subject = True, "livelink", unreal.getsockname()[1], "Ada"
        start()
        ticks_until(lambda: running().worker.output.sent > 30)
        frames = [LiveLinkDecoder().decode(unreal.recv(4096))[0] for _ in range(30)]
        bpy.ops.facemime.stop_puppet()
    assert {frame.subject for frame in frames} == {"Ada"}
    assert max(frame.face.coefficients[COEFFICIENT_INDEX["jawOpen"]] for frame in frames if frame.face) > 0.05


@pytest.mark.parametrize(
    ("protocol", "settings"),
    [
        ("livelink", {"host": "0.0.0.0"}),
        ("vmc", {"host": "192.168.1.7"}),
        ("ifacialmocap", {"phone": "192.168.1.8"}),
        ("vtubestudio", {"phone": "phone.local"}),
        ("own", {"host": "::"}),
    ],
)
def test_streams_from_other_computers_need_online_access(online, protocol, settings):
    stream = bpy.context.scene.facemime.source.stream
    bpy.context.scene.facemime.source.kind, stream.protocol = "STREAM", protocol
    for name, value in settings.items():
        setattr(stream, name, value)
    add_head(bpy.context)
    with pytest.raises(RuntimeError, match="Online Access"):
        bpy.ops.facemime.puppet()
    assert running() is None


@pytest.mark.parametrize("protocol", ["vmc", "vtubestudio"])
@pytest.mark.parametrize("host", ["192.168.1.7", "example.invalid", "0.0.0.0", "127.0.0.1.example.invalid"])
def test_sending_to_other_computers_needs_online_access(online, take, host, protocol):
    output = bpy.context.scene.facemime.output
    output.enabled, output.protocol, output.host = True, protocol, host
    add_head(bpy.context)
    before = threading.active_count()
    with pytest.raises(RuntimeError, match="Online Access"):
        bpy.ops.facemime.puppet()
    assert running() is None and threading.active_count() == before


def test_streams_on_this_computer_need_no_online_access(online):
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.stream.port = "STREAM", free_port()
    settings.output.enabled, settings.output.protocol = True, "openseeface"
    source, sender = open_source(settings.source), open_sender(settings)
    source.read(0.0)
    source.close()
    sender.close()
    settings.output.enabled = False
    assert open_sender(settings) is None


def test_a_port_in_use_is_reported(phone):
    head = add_head(bpy.context)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        bpy.context.scene.facemime.source.stream.port = other.getsockname()[1]
        assert bpy.ops.facemime.puppet() == {"RUNNING_MODAL"}
        session, end = running(), time.monotonic() + 60.0
        while session.worker.error is None:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert "Cannot listen" in str(session.worker.error)
        assert tick() == {"CANCELLED"}
    assert head.data.shape_keys is None


def test_a_missing_key_and_a_missing_phone_are_reported(tmp_path):
    add_head(bpy.context)
    source = bpy.context.scene.facemime.source
    source.kind, source.stream.protocol = "STREAM", "ifacialmocap"
    with pytest.raises(RuntimeError, match="address of the phone"):
        bpy.ops.facemime.puppet()
    source.stream.protocol, source.stream.key = "own", str(tmp_path / "none.key")
    with pytest.raises(RuntimeError, match="There is no key"):
        bpy.ops.facemime.puppet()


@pytest.fixture
def pairing():
    """The user's pairing, empty again afterwards."""
    yield preferences()
    preferences().pairing = ""


def test_a_paired_computer_drives_a_head_over_tls(pairing, online, tmp_path):
    identity = load_identity(tmp_path / "tls")
    sender = TlsSender("127.0.0.1", 0, identity.context, identity.token)
    with closing(sender), performing(sender, coefficient_take(60)):
        settings = bpy.context.scene.facemime
        settings.source.kind, settings.source.stream.protocol, settings.smoothing = "STREAM", "own", 0.0
        pairing.pairing = identity.pairing("localhost", sender.port).line
        head = add_head(bpy.context)
        rest = shown(head)
        start()
        ticks_until(lambda: np.abs(shown(head) - rest).max() > 0.005)
        assert running().worker.source.name == f"Facemime at localhost:{sender.port}"
        bpy.ops.facemime.stop_puppet()


@pytest.fixture
def across(tmp_path, monkeypatch):
    """Sending across networks, on a free port of this computer, with an identity of its own."""
    monkeypatch.setattr("facemime.settings.properties.private_folder", lambda name: tmp_path / name)
    output = bpy.context.scene.facemime.output
    output.enabled, output.across, output.listen, output.port = True, True, "127.0.0.1", free_port()
    return output


def test_a_paired_computer_receives_what_blender_sends_across_networks(across, phone):
    add_head(bpy.context)
    assert bpy.ops.facemime.copy_pairing_line() == {"FINISHED"}
    line = bpy.context.window_manager.clipboard or pairing_line(across)  # without a window, there is no clipboard
    start()
    with closing(StreamSource(StreamSettings(pairing=parse_pairing(line)), every=True)) as receiver:
        received = []
        ticks_until(lambda: received.append(receiver.read(0.0)) or sum(one is not None for one in received) > 10)
        sent = running().worker.output
        ticks_until(lambda: sent.sent > 10)  # counted after it was sent
        assert sent.receivers == 1 and not sent.message
        faces = [one.result for one in received if one is not None and one.result.found]
        assert len(faces) > 5 and np.abs(faces[-1].shape).max() > 0.1
    assert not bpy.ops.facemime.renew_pairing_line.poll(), "the puppet sends with the line"
    bpy.ops.facemime.stop_puppet()
    assert bpy.ops.facemime.renew_pairing_line() == {"FINISHED"} and pairing_line(across) != line


def test_sending_across_networks_needs_online_access_unless_it_stays_on_this_computer(across, online):
    across.listen = ""
    with pytest.raises(SourceError, match="Online Access"):
        open_sender(bpy.context.scene.facemime)
    across.listen = "localhost"
    open_sender(bpy.context.scene.facemime).close()


def test_the_line_states_the_address_by_which_others_reach_this_computer(across):
    across.public = "studio.example"
    assert parse_pairing(pairing_line(across)).address == f"studio.example:{across.port}"
    across.public = "https://studio.example"
    with pytest.raises(RuntimeError, match="not an address"):
        bpy.ops.facemime.copy_pairing_line()


def test_a_pairing_needs_online_access_and_a_complete_line(pairing, online):
    bpy.context.scene.facemime.source.kind, bpy.context.scene.facemime.source.stream.protocol = "STREAM", "own"
    add_head(bpy.context)
    pairing.pairing = Pairing("192.168.1.7", 21576, bytes(32), bytes(16)).line
    with pytest.raises(RuntimeError, match="Online Access"):
        bpy.ops.facemime.puppet()
    pairing.pairing = pairing.pairing[:-1]
    with pytest.raises(RuntimeError, match="not a complete pairing line"):
        bpy.ops.facemime.puppet()
    assert running() is None


def test_vtube_studio_receives_tracked_faces(take, tmp_path, monkeypatch):
    monkeypatch.setattr("facemime.settings.values.private_folder", lambda name: tmp_path / name)
    add_head(bpy.context)
    settings, studio = bpy.context.scene.facemime, Studio()
    settings.source.loop = True
    with at_port(studio) as port:
        output = settings.output
        output.enabled, output.protocol, output.port = True, "vtubestudio", port
        start()
        ticks_until(lambda: running().worker.output.sent > 20)
        settings.mirror = not settings.mirror
        some_frames()
        assert running().worker.output.options.mirror == settings.mirror
        bpy.ops.facemime.stop_puppet()
    mouths = {
        each["value"] for data in studio.injected() for each in data["parameterValues"] if each["id"] == "MouthOpen"
    }
    assert len(mouths) > 3 and (tmp_path / "vtube_studio" / "token").read_text().strip() == TOKEN
