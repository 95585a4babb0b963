"""Packets of phone apps are read as specified, and refused if invalid."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.face.names import COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix, from_face_axes
from facemime.core.heads.built_in import LOOKS, eyes_of_gaze, gaze_of
from facemime.core.streams.protocols import ifacialmocap, live_link, osc, vtube_studio
from facemime.core.streams.protocols.face_cap import NAMES, FaceCapDecoder
from facemime.core.streams.protocols.frames import MAX_DATAGRAM, FaceValues, PacketError
from facemime.core.streams.protocols.ifacialmocap import IFacialMocapDecoder
from facemime.core.streams.protocols.live_link import CURVES, LiveLinkDecoder
from facemime.core.streams.protocols.vtube_studio import VTubeStudioDecoder
from facemime.core.takes.measured import coefficient_face
from tests.helpers.stream_values import ANGLES, SHARES, distinct, value_of

RECORDING = Path(__file__).parents[3].parent / "shared" / "data" / "streams" / "livelink_iphone.udp"
"""Packets that a real iPhone sent."""

# Live Link Face


def golden_live_link(values=None, *, version=6, count=61) -> bytes:
    """A packet with the published layout: version, device, subject, time, rate, count and floats."""
    device, subject = b"12345678-1234-1234-1234-123456789abc", "iPhone 测试".encode()
    head = bytes([version]) + struct.pack(">I", 36) + device + struct.pack(">I", len(subject)) + subject
    head += struct.pack(">I", 1830) + struct.pack(">f", 0.5) + struct.pack(">II", 60, 1)
    return head if values is None else head + bytes([count]) + struct.pack(f">{len(values)}f", *values)


def test_live_link_face_is_read_as_published():
    values = [0.01 * n for n in range(1, 53)] + [0.1, 0.2, 0.3] + [0.0] * 6
    (frame,) = LiveLinkDecoder().decode(golden_live_link(values))
    assert frame.subject == "iPhone 测试" and frame.time == pytest.approx(1830.5 / 60.0)
    assert value_of(frame.face, "eyeBlinkLeft") == pytest.approx(0.01)
    assert value_of(frame.face, "jawForward") == pytest.approx(0.15)
    assert value_of(frame.face, "jawLeft") == pytest.approx(0.16)
    assert value_of(frame.face, "jawOpen") == pytest.approx(0.18)
    assert value_of(frame.face, "tongueOut") == pytest.approx(0.52)
    yaw, pitch, roll = 0.1, 0.2, 0.3
    np.testing.assert_allclose(frame.face.rotation, from_face_axes(-pitch, yaw, roll), atol=1e-6)
    assert frame.face.eyes is None  # as the angles of the eyes are 0


def about(axis: int, angle: float) -> np.ndarray:
    """Rotation about an axis by the right-hand rule."""
    turn, (i, j) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[j, i], turn[i, j] = np.sin(angle), -np.sin(angle)
    return turn


TO_HEAD = np.diag([1.0, -1.0, -1.0])
"""From ARKit's axes, to the viewer's right, up and towards the viewer, to those of the head frame, and back."""


@pytest.mark.parametrize("angles", [(0.3, 0.2, 0.1), (-0.5, 0.4, -0.2), (0.1, -0.6, 0.3)])
def test_the_head_turns_as_other_programs_read_arkits_transform(angles):
    x, y, z = angles
    turn = about(1, y) @ about(0, x) @ about(2, z)
    # The formulas with which recorders on iPhones fill in these three values.
    yaw, pitch = np.arctan2(turn[0, 2], turn[2, 2]), np.arcsin(turn[1, 2])
    roll = np.arctan2(turn[1, 0], turn[1, 1])
    (frame,) = LiveLinkDecoder().decode(golden_live_link([0.0] * 52 + [yaw, pitch, roll] + [0.0] * 6))
    np.testing.assert_allclose(euler_to_matrix(*frame.face.rotation), TO_HEAD @ turn @ TO_HEAD, atol=1e-6)


@pytest.mark.parametrize(("down", "left"), [(0.3, 0.1), (-0.2, 0.4), (0.4, -0.5), (0.0, 0.2)])
def test_the_eyes_look_where_arkits_transforms_of_the_eyes_do(down, left):
    # As in the phone's recording: no turn about the line of sight, angles about x, then y, then z, and yaw reversed.
    turn = about(1, left) @ about(0, down)
    pitch, yaw = np.arctan2(-turn[1, 2], turn[2, 2]), -np.arcsin(turn[0, 2])
    roll = np.arctan2(-turn[0, 1], turn[0, 0])
    both = [yaw, pitch, roll] * 2
    (frame,) = LiveLinkDecoder().decode(golden_live_link([0.0] * 55 + both))
    np.testing.assert_allclose(frame.face.eyes, [[down, -left]] * 2, atol=1e-6)
    (again,) = LiveLinkDecoder().decode(live_link.encode(frame.face, 0.0, subject="a", device="b"))
    np.testing.assert_allclose(again.face.eyes, frame.face.eyes, atol=1e-6)
    sent = struct.unpack(">61f", live_link.encode(frame.face, 0.0, subject="a", device="b")[-244:])
    np.testing.assert_allclose(sent[55:], both, atol=1e-6)


@pytest.mark.skipif(not RECORDING.is_file(), reason="the recording of ../shared/data is not here")
def test_a_person_who_holds_the_phone_looks_at_it():
    looks = []
    for data in recorded(RECORDING.read_bytes()):
        (frame,) = LiveLinkDecoder().decode(data)
        if frame.face is not None:
            result = coefficient_face().result(frame.face.coefficients, frame.face.rotation, eyes=frame.face.eyes)
            turn = euler_to_matrix(*result.gaze, 0.0)
            looks.append((euler_to_matrix(*frame.face.rotation) @ turn)[:, 2])
    down, aside = np.degrees(np.arcsin(-np.array(looks)[:, 1])), np.degrees(np.arctan2(*np.array(looks)[:, [0, 2]].T))
    assert len(looks) == 560
    assert abs(down.mean()) < 2.0 and down.std() < 4.0 and abs(aside.mean()) < 2.0 and aside.std() < 4.0


def recorded(data: bytes) -> Iterator[bytes]:
    """Packets that follow each other without their lengths."""
    at = 0
    while at < len(data):
        start, at = at, at + 1
        for _ in range(2):
            at += 4 + struct.unpack_from(">I", data, at)[0]
        at += 16
        at += 245 if data[at : at + 1] == b"=" else 0
        yield data[start:at]


@pytest.mark.parametrize(("unit", "scale"), [("radians", 1.0), ("degrees", np.pi / 180.0), ("half-turns", np.pi)])
def test_the_unit_of_live_link_faces_angles_can_be_chosen(unit, scale):
    (frame,) = LiveLinkDecoder(unit).decode(golden_live_link([0.0] * 52 + [0.0, 0.25, 0.0] + [0.0] * 6))
    assert frame.face.rotation[0] == pytest.approx(-0.25 * scale, abs=1e-6)


def test_live_link_face_without_values_has_no_face():
    assert LiveLinkDecoder().decode(golden_live_link())[0].face is None


@given(SHARES, ANGLES, st.floats(0.0, 1e5))
def test_live_link_face_survives_encoding_and_decoding(values, angles, time):
    face = FaceValues(np.array(values), np.array(angles))
    (frame,) = LiveLinkDecoder().decode(live_link.encode(face, time, subject="a", device="b"))
    np.testing.assert_allclose(frame.face.coefficients, values, atol=1e-7)
    np.testing.assert_allclose(frame.face.rotation, angles, atol=1e-5)
    gaze, vergence = gaze_of(face.coefficients[LOOKS])
    assert frame.time == pytest.approx(time, abs=1e-4)
    if frame.face.eyes is not None:
        np.testing.assert_allclose(frame.face.eyes, eyes_of_gaze(gaze, vergence), atol=1e-5)


@pytest.mark.parametrize(
    "data",
    [
        golden_live_link([0.0] * 61)[:-1],
        golden_live_link([0.0] * 61) + b"\0",
        golden_live_link([0.0] * 61, version=5),
        golden_live_link([0.0] * 61, count=60),
        golden_live_link([0.0] * 60, count=60),
        golden_live_link([float("nan")] + [0.0] * 60),
        golden_live_link([0.0] * 60 + [float("inf")]),
        golden_live_link([0.0] * 52 + [1e9] + [0.0] * 8),
        b"\6" + struct.pack(">I", 2**32 - 1) + bytes(40),
        b"\6" + bytes(30),
    ],
)
def test_invalid_packets_of_live_link_face_are_refused(data):
    with pytest.raises(PacketError):
        LiveLinkDecoder().decode(data)


# iFacialMocap

FIRST = (
    "mouthSmile_R-7|eyeLookOut_L-0|mouthUpperUp_L-11|eyeWide_R-0|mouthClose-8|mouthPucker-4|mouthRollLower-9|"
    "eyeBlink_R-7|eyeLookDown_L-17|cheekSquint_R-11|eyeBlink_L-29|tongueOut-0|jawRight-0|jawOpen-12|custom_1-50|"
    "=head#-21.5,-6.0,-6.6,-0.03,-0.1,-0.66|rightEye#6.0,2.4,0.25|leftEye#6.0,-1.6,-0.17|"
)


def test_both_versions_of_ifacialmocap_are_read():
    second = FIRST.replace("-7|", "&7|").replace("-12|", "&12|").replace("_1-50", "_1&-50").replace("_L-29", "Left&29")
    for text in (FIRST, second):
        (frame,) = IFacialMocapDecoder().decode(text.encode())
        assert value_of(frame.face, "jawOpen") == pytest.approx(0.12)
        assert value_of(frame.face, "mouthSmileRight") == pytest.approx(0.07)
        assert value_of(frame.face, "eyeBlinkLeft") == pytest.approx(0.29)
        degrees = np.radians([-21.5, -6.0, -6.6])
        np.testing.assert_allclose(frame.face.rotation, from_face_axes(*degrees), atol=1e-9)
        np.testing.assert_allclose(frame.face.position, [-0.03, 0.1, 0.66])


@pytest.mark.parametrize(
    "text",
    [
        FIRST + "\r\n",
        FIRST.replace("|", " |\n"),
        FIRST.replace("|=head", "=head"),
        FIRST.replace("=head", "=|head"),
        FIRST.removesuffix("|") + "|34903,-1.66,-0.17||||3|",
        FIRST + "___iFacialMocap",
        "trackingStatus-1|hapihapi-0|" + FIRST,
        "=head" + FIRST.partition("=head")[2] + FIRST.partition("=head")[0],
        FIRST.replace("custom_1", "独自の笑顔"),
        FIRST.replace("custom_1-50", "jawForward-x"),
    ],
)
def test_ifacialmocap_is_read_part_by_part_as_other_programs_write_it(text):
    """The layouts are those of VCR's, VTuberHub's and Warudo's packets, of ARKit apps in Unity, and of Facemotion3d."""
    (frame,) = IFacialMocapDecoder().decode(text.encode())
    (wanted,) = IFacialMocapDecoder().decode(FIRST.encode())
    np.testing.assert_array_equal(frame.face.coefficients, wanted.face.coefficients)
    np.testing.assert_array_equal(frame.face.rotation, wanted.face.rotation)
    np.testing.assert_array_equal(frame.face.position, wanted.face.position)


def test_ifacialmocap_without_the_head_or_its_position_leaves_the_head_as_it_was():
    decoder, turned = IFacialMocapDecoder(), from_face_axes(*np.radians([10.0, 20.0, -5.0]))
    for text in ("jawOpen-12|=head#10,20,-5|", "jawOpen-50|", "jawOpen-50|=head#nan,0,0,0,0,0|"):
        (frame,) = decoder.decode(text.encode())
        np.testing.assert_allclose(frame.face.rotation, turned, atol=1e-9)
        assert frame.face.position is None
    assert value_of(frame.face, "jawOpen") == 0.5


@pytest.mark.parametrize("mark", ["-", "&"])
def test_ifacialmocap_that_has_lost_the_face_says_so(mark):
    lost, seen = ((f"trackingStatus{mark}{n}|" + FIRST).encode() for n in (0, 1))
    assert IFacialMocapDecoder().decode(lost)[0].face is None
    assert IFacialMocapDecoder().decode(seen)[0].face is not None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "hello",
        "hello-5|=head#0,0,0,0,0,0|",
        "jawOpen-1" + "2" * 30,
        "jawOpen-x",
        FIRST + "a" * 20_000,
        FIRST.replace("=head#-21.5", "=head#9999"),
        '{"jawOpen": 5}',
        ifacialmocap.START.decode(),
    ],
)
def test_invalid_packets_of_ifacialmocap_are_refused(text):
    with pytest.raises(PacketError):
        IFacialMocapDecoder().decode(text.encode())


def test_the_phone_gets_the_request_of_its_own_protocol():
    assert ifacialmocap.START.startswith(b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719")
    assert ifacialmocap.FACEMOTION_START == b"FACEMOTION3D_OtherStreaming"


# VTube Studio's phone and MeowFace


def golden_vtube_studio(**changed) -> bytes:
    values = [
        {"k": name[0].upper() + name[1:], "v": float(v)} for name, v in zip(COEFFICIENTS, distinct(), strict=True)
    ]
    packet = {
        "Timestamp": 1_700_000_000_123,
        "Hotkey": -1,
        "FaceFound": True,
        "Rotation": {"x": 10.0, "y": -20.0, "z": 5.0},
        "Position": {"x": 1.0, "y": 2.0, "z": -30.0},
        "VNyanPos": {"x": 0.0, "y": 0.0, "z": 0.0},
        "EyeLeft": {"x": 1.0, "y": 2.0, "z": 0.0},
        "EyeRight": {"x": 1.0, "y": 2.0, "z": 0.0},
        "BlendShapes": values,
    }
    return json.dumps(packet | changed).encode()


def test_vtube_studio_is_read_by_name_whatever_the_spelling():
    (frame,) = VTubeStudioDecoder().decode(golden_vtube_studio())
    np.testing.assert_allclose(frame.face.coefficients, distinct())
    assert frame.time == pytest.approx(1_700_000_000.123)
    np.testing.assert_allclose(frame.face.rotation, from_face_axes(*np.radians([-20.0, 10.0, 5.0])), atol=1e-9)
    meow = [{"k": name.replace("Left", "_L").replace("Right", "_R"), "v": 0.25} for name in COEFFICIENTS]
    meow = [entry for entry in meow if "_" in entry["k"]] + [{"k": "unknown", "v": 1}]
    (frame,) = VTubeStudioDecoder().decode(golden_vtube_studio(BlendShapes=meow))
    assert value_of(frame.face, "eyeBlinkLeft") == 0.25


def test_vtube_studio_on_android_is_read_with_its_halves_and_its_unused_spellings():
    sent = {"browInnerUp_L": 0.8, "browInnerUp_R": 0.6, "cheekPuff_L": 0.4, "EyeBlinkLeft": 0.9, "eyeBlink_L": 0.002}
    entries = [{"k": name, "v": value} for name, value in sent.items()]
    (frame,) = VTubeStudioDecoder().decode(golden_vtube_studio(BlendShapes=entries))
    for name, value in (("browInnerUp", 0.7), ("cheekPuff", 0.4), ("eyeBlinkLeft", 0.9)):
        assert value_of(frame.face, name) == pytest.approx(value)


@pytest.mark.parametrize("stamp", [None, 0, -1, "now", True])
def test_vtube_studio_without_a_time_is_played_evenly(stamp):
    packet = json.loads(golden_vtube_studio()) | {"Timestamp": stamp}
    text = json.dumps({key: value for key, value in packet.items() if value is not None})
    (frame,) = VTubeStudioDecoder().decode(text.encode())
    assert frame.time is None
    np.testing.assert_allclose(frame.face.coefficients, distinct())


def test_vtube_studio_with_little_else_than_values_is_read():
    """As programs that track a webcam with MediaPipe send: few or foreign names among the values, and no position."""
    entries = [{"k": "_neutral", "v": 1e-6}, {"k": "jawOpen", "v": 0.5}, {"k": "mouthClose", "v": None}, {}]
    text = json.dumps({"FaceFound": True, "BlendShapes": entries, "Rotation": {"x": 0, "y": -20, "z": 0}})
    (frame,) = VTubeStudioDecoder().decode(text.encode())
    assert value_of(frame.face, "jawOpen") == 0.5 and frame.face.position is None
    np.testing.assert_allclose(frame.face.rotation, from_face_axes(*np.radians([-20.0, 0.0, 0.0])), atol=1e-9)
    assert VTubeStudioDecoder().decode(b'{"FaceFound": false, "BlendShapes": []}')[0].face is None


def test_vtube_studio_reports_when_there_is_no_face():
    assert VTubeStudioDecoder().decode(golden_vtube_studio(FaceFound=False))[0].face is None


def test_the_request_is_the_documented_one():
    asked = json.loads(vtube_studio.request(50_000))
    assert asked["messageType"] == "iOSTrackingDataRequest" and asked["ports"] == [50_000]
    assert asked["time"] == asked["sendForSeconds"] == 5
    assert 0.5 <= asked["time"] <= 10.0 and 1 <= len(asked["sentBy"]) <= 32


@pytest.mark.parametrize(
    "data",
    [
        b"{",
        b"{}",
        b"[" * 10_000,
        b'{"a":' * 5_000,
        golden_vtube_studio(Rotation={"x": 1e400, "y": 0, "z": 0}).replace(b"Infinity", b"1e400"),
        golden_vtube_studio(BlendShapes=[]),
        golden_vtube_studio(BlendShapes=[{"k": "JawOpen"}] * 20),
        golden_vtube_studio(BlendShapes=[{"k": "JawOpen", "v": True}] * 20),
        golden_vtube_studio(FaceFound=1),
        golden_vtube_studio() + b" " * MAX_DATAGRAM,
        golden_vtube_studio() + b"x",
    ],
)
def test_invalid_packets_of_vtube_studio_are_refused(data):
    with pytest.raises(PacketError):
        VTubeStudioDecoder().decode(data)


# Face Cap


def test_face_cap_is_read_by_number_in_single_messages_and_in_bundles():
    order = dict(zip(NAMES, distinct(), strict=True))
    messages = [osc.encode_message("/HT", 0.0, 0.0, -0.5), osc.encode_message("/HR", 10.0, 20.0, 5.0)]
    messages += [osc.encode_message("/HRQ", 0.0, 0.0, 0.0, 1.0), osc.encode_message("/ELR", 0.0, 0.0)]
    messages += [osc.encode_message("/W", number, value) for number, value in enumerate(order.values())]
    single = FaceCapDecoder()
    frames = [frame for message in messages for frame in single.decode(message)]
    bundled = [frame for bundle in osc.encode_bundles(messages, 9000) for frame in FaceCapDecoder().decode(bundle)]
    assert len(frames) == len(bundled) == 1
    for frame in (*frames, *bundled):
        for name, value in order.items():
            assert value_of(frame.face, name) == pytest.approx(value)
        np.testing.assert_allclose(frame.face.rotation, from_face_axes(*np.radians([10.0, 20.0, 5.0])), atol=1e-6)
    # The first, the 25th and the last, as its documentation counts them.
    assert (NAMES[0], NAMES[24], NAMES[51]) == ("browInnerUp", "jawOpen", "tongueOut")
    assert sorted(NAMES) == sorted(COEFFICIENTS) == sorted(CURVES)


def test_face_cap_with_integers_is_read_as_with_other_numbers():
    """Libraries write whole numbers as integers: python-osc by default, Max and Pure Data always."""
    messages = [osc.encode_message("/HR", 10, -20, 5), osc.encode_message("/HT", 0, 0, -1)]
    messages += [osc.encode_message("/W", 24, 1), osc.encode_message("/W", 25.0, 0.5), osc.encode_message("/W", 51, 0)]
    (frame,) = FaceCapDecoder().decode(next(osc.encode_bundles(messages, 9000)))
    assert value_of(frame.face, "jawOpen") == 1.0 and value_of(frame.face, "jawForward") == 0.5
    np.testing.assert_allclose(frame.face.rotation, from_face_axes(*np.radians([10.0, -20.0, 5.0])), atol=1e-9)
    np.testing.assert_array_equal(frame.face.position, [0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    "odd",
    [
        osc.encode_message("/filter", 1),
        osc.encode_message("/W", 53, 0.5),
        osc.encode_message("/W", 3, "x"),
        osc.encode_message("/HR", 1.0),
        osc.encode_message("/HR", 1e9, 0.0, 0.0),
        osc.encode_message("/HT", 1e9, 0.0, 0.0),
        b"/W\0\0,b\0\0" + struct.pack(">i", 2) + bytes(4),
    ],
)
def test_an_odd_message_does_not_discard_a_frame_of_face_cap(odd):
    messages = [odd, osc.encode_message("/W", 24, 0.5), odd]
    (frame,) = FaceCapDecoder().decode(next(osc.encode_bundles(messages, 9000)))
    assert value_of(frame.face, "jawOpen") == 0.5 and not frame.face.rotation.any() and frame.face.position is None


@pytest.mark.parametrize(
    "message",
    [
        osc.encode_message("/W", 52, 0.5),
        osc.encode_message("/W", -1, 0.5),
        osc.encode_message("/W", 1.5, 0.5),
        osc.encode_message("/W", 1),
        osc.encode_message("/HR", 1.0, 2.0),
        osc.encode_message("/HR", 1.0, 2.0, "x"),
        osc.encode_message("/X", 1.0),
    ],
)
def test_invalid_messages_of_face_cap_are_refused(message):
    with pytest.raises(PacketError):
        FaceCapDecoder().decode(message)
