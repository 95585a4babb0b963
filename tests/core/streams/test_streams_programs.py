"""Packets of programs on computers follow their specification, survive encoding, and are refused if invalid."""

import socket
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_packet import OscPacket

from facemime.core.face.landmarks import IBUG68_INDICES, MOUTH_CORNERS
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS, N_COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix, to_quaternion
from facemime.core.streams.protocols import openseeface, osc, vmc
from facemime.core.streams.protocols.frames import FaceValues, PacketError
from facemime.core.streams.protocols.openseeface import OpenSeeFaceDecoder, fit_pose
from facemime.core.streams.protocols.vmc import VmcDecoder
from facemime.core.streams.sender import StreamSender
from facemime.core.streams.stream_settings import SendSettings
from facemime.core.takes.measured import IMAGE_SIZE, coefficient_face
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.timing import project
from tests.helpers.stream_values import ANGLES, SHARES, value_of
from tests.helpers.takes import coefficient_take, performance

# VMC


def test_vmc_accepts_arkits_names_in_any_case_and_the_heads_bone():
    decoder = VmcDecoder()
    messages = [osc.encode_message("/VMC/Ext/OK", 1), osc.encode_message("/VMC/Ext/T", 2.5)]
    turn = to_quaternion(euler_to_matrix(0.1, -0.2, 0.3))
    messages += [osc.encode_message("/VMC/Ext/Bone/Pos", "Head", 0.0, 0.0, 0.0, *turn)]
    messages += [osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen", 0.5)]
    messages += [osc.encode_message("/VMC/Ext/Blend/Val", "eyeblinkleft", 0.25)]
    assert not [frame for message in messages for frame in decoder.decode(message)]
    (frame,) = decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))
    assert frame.time == 2.5 and value_of(frame.face, "jawOpen") == 0.5 and value_of(frame.face, "eyeBlinkLeft") == 0.25
    np.testing.assert_allclose(frame.face.rotation, [0.1, -0.2, 0.3], atol=1e-6)


def turned_bones(right: tuple[float, float], left: tuple[float, float]) -> list[bytes]:
    """Eye bones that are turned by angles down and to the avatar's right, about Unity's axes: to the right and up."""
    messages = []
    for name, (down, across) in (("RightEye", right), ("LeftEye", left)):
        yaw, pitch = np.array([0.0, np.sin(across / 2), 0.0]), np.array([np.sin(down / 2), 0.0, 0.0])
        w, v = np.cos(across / 2), np.cos(down / 2)
        x, y, z = w * pitch + v * yaw + np.cross(yaw, pitch)  # first down, then across, as Unity's Euler angles
        messages.append(osc.encode_message("/VMC/Ext/Bone/Pos", name, 0.0, 0.0, 0.0, x, y, z, w * v))
    return messages


def test_vmc_looks_where_the_eye_bones_do():
    decoder = VmcDecoder()
    for message in turned_bones((0.2, 0.1), (0.2, 0.3)):
        decoder.decode(message)
    decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen", 0.5))
    (frame,) = decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))
    np.testing.assert_allclose(frame.face.eyes, [[0.2, 0.1], [0.2, 0.3]], atol=1e-6)
    assert value_of(frame.face, "eyeLookInLeft") > value_of(frame.face, "eyeLookOutRight") > 0.1
    assert value_of(frame.face, "eyeLookDownLeft") > 0.3 and value_of(frame.face, "jawOpen") == 0.5


@pytest.mark.parametrize("eyes", [((0.0, 0.0), (0.0, 0.0)), ((1.5, 0.0), (1.5, 0.0))])
def test_vmc_without_tracked_eyes_looks_where_the_expressions_say(eyes):
    decoder = VmcDecoder()
    for message in (*turned_bones(*eyes), osc.encode_message("/VMC/Ext/Blend/Val", "EyeLookDownLeft", 0.5)):
        decoder.decode(message)
    (frame,) = decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))
    assert frame.face.eyes is None and value_of(frame.face, "eyeLookDownLeft") == 0.5


def test_vmc_accepts_vrms_names_if_there_are_no_others():
    decoder = VmcDecoder()
    for name, value in (("A", 0.6), ("Blink_L", 1.0), ("Joy", 0.5), ("LookUp", 0.25)):
        decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", name, value))
    (frame,) = decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))
    assert value_of(frame.face, "jawOpen") == pytest.approx(0.6) and value_of(frame.face, "eyeBlinkLeft") == 1.0
    assert value_of(frame.face, "mouthSmileLeft") == 0.5 and value_of(frame.face, "eyeLookUpRight") == 0.25


def test_vmc_without_tracking_has_no_face():
    decoder = VmcDecoder()
    decoder.decode(osc.encode_message("/VMC/Ext/OK", 1, 3, 0, 0))
    assert decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))[0].face is None


@given(SHARES, ANGLES)
def test_vmc_survives_encoding_in_bundles_that_fit_a_packet_and_applies_last(values, angles):
    bundles = list(vmc.encode(FaceValues(np.array(values), np.array(angles)), 1.5))
    assert len(bundles) > 1 and all(len(bundle) <= 1400 for bundle in bundles)
    addresses = [timed.message.address for bundle in bundles for timed in OscPacket(bundle).messages]
    assert addresses[-1] == "/VMC/Ext/Blend/Apply" and addresses.count("/VMC/Ext/Blend/Apply") == 1
    decoder = VmcDecoder()
    frames = [frame for bundle in bundles for frame in decoder.decode(bundle)]
    assert len(frames) == 1
    np.testing.assert_allclose(frames[0].face.coefficients, values, atol=1e-7)
    np.testing.assert_allclose(frames[0].face.rotation, angles, atol=1e-6)


def expressions_in(bundles) -> dict[str, float]:
    """Names and values of expressions, as a library reads them."""
    messages = [timed.message for bundle in bundles for timed in OscPacket(bundle).messages]
    return {message.params[0]: message.params[1] for message in messages if message.address.endswith("Val")}


@pytest.mark.parametrize(("names", "lid"), [("arkit", ["EyeBlinkLeft"]), ("vrm", ["Blink_L", "blinkLeft"])])
def test_vmc_shuts_a_lid_by_one_set_of_names_and_sends_the_other_as_0(names, lid):
    coefficients = np.zeros(N_COEFFICIENTS)
    coefficients[COEFFICIENT_INDEX["eyeBlinkLeft"]] = 0.75
    sent = expressions_in(vmc.encode(FaceValues(coefficients, np.zeros(3)), 0.0, names))
    assert {name for name, value in sent.items() if value} == set(lid)
    assert {sent[name] for name in lid} == {0.75}
    assert {"A", "aa", "Joy", "happy", "EyeBlinkLeft"} <= sent.keys()


def test_vmc_reads_vrms_names_where_arkits_are_sent_as_0():
    coefficients = np.zeros(N_COEFFICIENTS)
    coefficients[COEFFICIENT_INDEX["jawOpen"]] = 0.5
    decoder = VmcDecoder()
    bundles = vmc.encode(FaceValues(coefficients, np.zeros(3)), 0.0, "vrm")
    (frame,) = [frame for bundle in bundles for frame in decoder.decode(bundle)]
    assert value_of(frame.face, "jawOpen") > 0.3


@pytest.mark.parametrize(
    ("chosen", "answer", "moving"),
    [
        ("automatic", "", "Blink_L"),
        ("automatic", "Blink_L", "Blink_L"),
        ("automatic", "EyeBlinkLeft", "EyeBlinkLeft"),
        ("arkit", "", "EyeBlinkLeft"),
        ("vrm", "EyeBlinkLeft", "Blink_L"),
    ],
)
def test_vmc_moves_the_expressions_that_the_avatar_has_or_that_are_chosen(chosen, answer, moving):
    take = coefficient_take(4)
    take.coefficients[:, COEFFICIENT_INDEX["eyeBlinkLeft"]] = 0.5
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        settings = SendSettings("vmc", port=receiver.getsockname()[1], expressions=chosen)
        sender = StreamSender(settings)
        for frame in range(2):
            sender.send(frame / 60.0, take.result(frame), calibrate(take))
            bundles = []
            while not bundles or b"Apply" not in bundles[-1]:
                data, address = receiver.recvfrom(2048)
                bundles.append(data)
            if answer:
                receiver.sendto(osc.encode_message("/VMC/Ext/Blend/Val", answer, 0.0), address)
        sender.close()
    sent = expressions_in(bundles)
    assert [name for name in ("EyeBlinkLeft", "Blink_L") if sent[name] > 0.0] == [moving]


def vmc_frame(*messages):
    """The frame that a bundle completes which also has 52 good values."""
    values = [osc.encode_message("/VMC/Ext/Blend/Val", name, 0.5) for name in COEFFICIENTS]
    bundle = next(osc.encode_bundles([*messages, *values, osc.encode_message("/VMC/Ext/Blend/Apply")], 9999))
    (frame,) = VmcDecoder().decode(bundle)
    np.testing.assert_array_equal(frame.face.coefficients, 0.5)
    return frame


def test_vmc_takes_integers_as_numbers():
    """As libraries write whole numbers: python-osc, node-osc with automatic types, and Max."""
    frame = vmc_frame(
        osc.encode_message("/VMC/Ext/Bone/Pos", "Head", 0, 0, 0, 0, 1, 0, 0), osc.encode_message("/VMC/Ext/T", 3)
    )
    assert frame.time == 3.0
    np.testing.assert_allclose(euler_to_matrix(*frame.face.rotation), np.diag([-1.0, 1.0, -1.0]), atol=1e-9)
    decoder = VmcDecoder()
    decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen", 1))
    assert value_of(decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))[0].face, "jawOpen") == 1.0


@pytest.mark.parametrize(
    "odd",
    [
        osc.encode_message("/other", 1),
        osc.encode_message("/avatar/parameters/v2/JawOpen", 0.5),
        osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen"),
        osc.encode_message("/VMC/Ext/Blend/Val", 1, 0.5),
        osc.encode_message("/VMC/Ext/Bone/Pos", "Head", *[0] * 7),
        osc.encode_message("/VMC/Ext/Bone/Pos", "Head", *[0.0] * 7),
        osc.encode_message("/VMC/Ext/Bone/Pos", "LeftUpperArm", *[0.0] * 7),
        osc.encode_message("/VMC/Ext/Bone/Pos", "Head", *[0.0] * 6, float("nan")),
        osc.encode_message("/VMC/Ext/Root/Pos", "root", *[0.0] * 13),
        osc.encode_message("/VMC/Ext/T", "now"),
        b"/VMC/Ext/Blend/Val\0\0,sN\0JawOpen\0",
        b"/VMC/Ext/Blend/Val\0\0,sb\0JawOpen\0" + struct.pack(">i", 1) + bytes(4),
        b"/VMC/Ext/Blend/Val\0\0,sf\0JawOpen\0",
    ],
)
def test_an_odd_message_does_not_discard_a_frame_of_vmc(odd):
    assert not vmc_frame(odd).face.rotation.any()


@pytest.mark.parametrize(
    "message",
    [
        osc.encode_message("/other", 1),
        osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen"),
        osc.encode_message("/VMC/Ext/Blend/Val", 1, 0.5),
        osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen", "x"),
        osc.encode_message("/VMC/Ext/Bone/Pos", "Head", 0.0),
        osc.encode_message("/VMC/Ext/Bone/Pos", "Head", *[0.0] * 7),
    ],
)
def test_invalid_messages_of_vmc_are_refused(message):
    with pytest.raises(PacketError):
        VmcDecoder().decode(message)


def test_a_frame_of_vmc_ends_when_a_value_comes_again_if_none_is_ever_applied():
    decoder, frames = VmcDecoder(), []
    for step in range(4):
        for name in ("jawOpen", "mouthClose"):
            frames += decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", name, 0.25 * step))
    assert [value_of(frame.face, "jawOpen") for frame in frames] == [0.0, 0.25, 0.5]
    assert len(decoder.decode(osc.encode_message("/VMC/Ext/Blend/Apply"))) == 1
    assert decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", "jawOpen", 0.1)) == []
    assert decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", "jawOpen", 0.2)) == []


def test_vmc_remembers_a_limited_number_of_names():
    decoder = VmcDecoder()
    with pytest.raises(PacketError):
        for number in range(2000):
            decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", f"name{number}", 0.5))


# OpenSeeFace


def golden_openseeface(points, places, *, found=1) -> bytes:
    """A packet with the layout of OpenSeeFace's own receiver, for 68 points in the image and 70 on the face."""
    data = struct.pack("<di", 12.5, 3) + struct.pack("<2f", 640.0, 480.0) + struct.pack("<2f", 0.9, 0.8)
    data += struct.pack("<B", found) + struct.pack("<f", 1.0) + struct.pack("<4f", 0.0, 0.0, 0.0, 1.0)
    data += struct.pack("<3f", 0.0, 0.0, 90.0) + struct.pack("<3f", 0.0, 0.0, 5.0) + struct.pack("<68f", *[0.9] * 68)
    data += struct.pack("<136f", *np.ravel(points)) + struct.pack("<210f", *np.ravel(places))
    return data + struct.pack("<14f", *[0.0] * 14)


def ibug_of_openseeface() -> list[int]:
    """The iBUG numbers of OpenSeeFace's 66 points: 58 and 62 are the inner corners of the mouth."""
    return [*range(48), *range(49, 54), *range(55, 60), 60, 61, 62, 63, 64, 65, 66, 67]


def test_points_of_openseeface_are_remapped_so_that_no_mouth_is_scrambled():
    rng = np.random.default_rng(0)
    points, places = rng.uniform(0, 400, (68, 2)), rng.normal(size=(70, 3))
    (frame,) = OpenSeeFaceDecoder().decode(golden_openseeface(points, places))
    theirs = ibug_of_openseeface()
    for ours, ibug in enumerate(IBUG68_INDICES.tolist()):
        # The inner corners stand for the outer ones, which are not sent.
        number = theirs.index({48: 60, 54: 64}.get(ibug, ibug))
        np.testing.assert_allclose(frame.face.landmarks[ours], points[number], rtol=1e-6)
        np.testing.assert_allclose(frame.face.shape[ours] * 0.63181, places[number] * (-1, 1, 1), rtol=1e-5)
    np.testing.assert_allclose(frame.face.landmarks[MOUTH_CORNERS], points[[58, 62]], rtol=1e-6)
    assert frame.subject == "3" and frame.time == 12.5


def test_openseeface_without_points_in_space_has_no_face():
    assert (
        OpenSeeFaceDecoder().decode(golden_openseeface(np.zeros((68, 2)), np.zeros((70, 3)), found=0))[0].face is None
    )


def test_several_faces_of_openseeface_are_distinguished():
    take = performance()
    one = openseeface.encode(take.result(0), 1.0, (640, 480))
    other = one[:8] + struct.pack("<i", 7) + one[12:]
    assert [frame.subject for frame in OpenSeeFaceDecoder().decode(one + other)] == ["0", "7"]


@given(ANGLES, st.floats(30.0, 300.0), st.floats(0.0, 1200.0), st.floats(0.0, 700.0))
def test_the_pose_is_found_in_points_without_it(angles, scale, x, y):
    shape = coefficient_face().neutral.shape
    landmarks = scale * (shape @ euler_to_matrix(*angles).T)[:, :2] + (x, y)
    pose = fit_pose(shape, landmarks)
    np.testing.assert_allclose(pose, [scale, *angles, x, y], atol=1e-6)


def test_openseeface_survives_encoding_and_decoding():
    take = performance()
    for frame in (0, 20, 40):
        result = take.result(frame)
        result = replace(result, landmarks=project(result.shape[None], result.pose[None])[0])
        (found,) = OpenSeeFaceDecoder().decode(openseeface.encode(result, 3.0, (640, 480)))
        np.testing.assert_allclose(found.face.shape, result.shape, atol=1e-6)
        np.testing.assert_allclose(found.face.pose, result.pose, rtol=1e-4, atol=1e-3)


def test_the_gaze_survives_openseeface():
    values = np.zeros(N_COEFFICIENTS)
    values[[COEFFICIENT_INDEX[name] for name in ("eyeLookOutLeft", "eyeLookInRight", "eyeLookDownLeft")]] = (
        0.5,
        0.4,
        0.2,
    )
    result = coefficient_face().result(values, np.zeros(3))
    (found,) = OpenSeeFaceDecoder().decode(openseeface.encode(result, 0.0, IMAGE_SIZE))
    np.testing.assert_allclose(found.face.gaze, result.gaze, atol=1e-4)
    assert found.face.vergence == pytest.approx(result.vergence, abs=1e-4)


# The outer and inner corners of the eyes of the face in OpenSeeFace's tracker: right eye, left eye.
OWN_EYES = np.array(
    [
        [0.315905195966084, 0.298337502555443, -0.285107407636464],
        [0.131229723798772, 0.284447361805627, -0.234239149487417],
        [-0.131229723798772, 0.284447361805627, -0.234239149487417],
        [-0.315905195966084, 0.298337502555443, -0.285107407636464],
    ]
)


def test_the_face_in_openseefaces_tracker_is_one_outer_eye_distance_wide():
    places = np.random.default_rng(0).normal(size=(70, 3))
    places[[36, 39, 42, 45]] = OWN_EYES * (1, -1, -1)  # as its tracker sends it
    points = np.random.default_rng(1).uniform(0, 400, (68, 2))
    (frame,) = OpenSeeFaceDecoder().decode(golden_openseeface(points, places))
    width = np.linalg.norm(np.subtract(*frame.face.shape[[36, 45]]))
    assert width == pytest.approx(1.0, abs=1e-4)


def test_the_corners_of_the_mouth_are_sent_as_openseefaces_tracker_measures_them():
    take = coefficient_take(60)
    rest = coefficient_face().neutral.shape
    measured, sent = [], []
    for frame in range(len(take)):
        data = openseeface.encode(take.result(frame), 0.0, (640, 480), rest)
        y = -np.frombuffer(data, "<f4", 210, len(data) - 4 * (210 + 14)).reshape(70, 3)[:, 1]  # the tracker's is up
        nose = np.mean([y[27] - y[28], y[28] - y[29], y[29] - y[30]])
        lip = np.mean(y[[49, 50, 51]])
        measured.append([(lip - y[62]) / nose, (lip - y[58]) / nose])
        sent.append(struct.unpack("<14f", data[-56:])[8:12:2])
    for side in range(2):
        assert np.corrcoef(np.array(measured)[:, side], np.array(sent)[:, side])[0, 1] > 0.98


@pytest.mark.parametrize("size", [(640, 480), (1080, 1920)])
def test_openseeface_is_told_the_size_of_the_image(size):
    take = performance()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        sender = StreamSender(SendSettings("openseeface", port=receiver.getsockname()[1]))
        sender.send(0.0, take.result(0), None, size)
        sender.close()
        assert struct.unpack_from("<2f", receiver.recv(2048), 12) == size


def test_a_frontal_face_has_the_rotation_that_openseefaces_receivers_expect():
    """Receivers subtract 90 degrees from z and turn x by 180; the remainder looks straight into the camera."""
    values, angles = np.zeros(N_COEFFICIENTS), np.array([0.01, 0.01, 0.01])
    data = openseeface.encode(coefficient_face().result(values, angles), 0.0, IMAGE_SIZE)
    x, y, z, *moved = struct.unpack_from("<6f", data, 8 + 4 + 8 + 8 + 1 + 4 + 16)
    assert abs(x) == pytest.approx(180.0, abs=1.0)
    assert y == pytest.approx(0.0, abs=1.0) and z == pytest.approx(90.0, abs=1.0)
    assert -moved[2] > 0.0


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d[:-1],
        lambda d: d + b"\0",
        lambda d: d * 17,
        lambda d: b"",
        lambda d: d[:28] + b"\7" + d[29:],
        lambda d: d[:73] + struct.pack("<f", float("nan")) + d[77:],
        lambda d: d[:500] + struct.pack("<f", 1e30) + d[504:],
        lambda d: d[:-900] + bytes(844) + d[-56:],
    ],
)
def test_invalid_packets_of_openseeface_are_refused(change):
    data = openseeface.encode(performance().result(0), 1.0, (640, 480))
    with pytest.raises(PacketError):
        OpenSeeFaceDecoder().decode(change(data))
