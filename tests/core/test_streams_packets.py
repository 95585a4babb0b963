"""Packets of every protocol: as their specifications have them, there and back, and refused where they are wrong."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

from facemime.core.coefficient_names import COEFFICIENT_INDEX, COEFFICIENTS, N_COEFFICIENTS
from facemime.core.landmarks import IBUG68_INDICES, MOUTH_CORNERS
from facemime.core.rotation import euler_to_matrix, from_face_axes, to_face_axes
from facemime.core.streams import datagram, ifacialmocap, live_link, openseeface, osc, vmc, vtube_studio
from facemime.core.streams.face_cap import NAMES, FaceCapDecoder
from facemime.core.streams.frames import (
    MAX_DATAGRAM,
    FaceValues,
    PacketError,
    from_quaternion,
    to_quaternion,
)
from facemime.core.streams.ifacialmocap import IFacialMocapDecoder
from facemime.core.streams.live_link import CURVES, LiveLinkDecoder
from facemime.core.streams.openseeface import OpenSeeFaceDecoder, fit_pose
from facemime.core.streams.vmc import VmcDecoder
from facemime.core.streams.vtube_studio import VTubeStudioDecoder
from facemime.core.takes.from_coefficients import coefficient_face
from facemime.core.takes.timing import project
from takes import performance

SHARES = st.lists(st.floats(0.0, 1.0, width=32), min_size=N_COEFFICIENTS, max_size=N_COEFFICIENTS)
ANGLES = st.tuples(*[st.floats(-1.2, 1.2)] * 3)


def value_of(face, name):
    return face.coefficients[COEFFICIENT_INDEX[name]]


def distinct() -> np.ndarray:
    """Coefficients that all differ, so that none can be taken for another."""
    return np.arange(1, N_COEFFICIENTS + 1) / 100.0


# Axes


@given(ANGLES)
def test_angles_about_the_axes_of_a_face_anchor_go_there_and_back(angles):
    np.testing.assert_allclose(from_face_axes(*to_face_axes(np.array(angles))), angles, atol=1e-9)


def test_a_face_anchor_that_turns_to_the_performers_left_has_a_negative_yaw():
    """Its y is up and its z towards the viewer: positive turns lead to the viewer's right, the performer's left."""
    np.testing.assert_allclose(from_face_axes(0.0, 0.3, 0.0), [0.0, -0.3, 0.0], atol=1e-12)
    np.testing.assert_allclose(from_face_axes(0.3, 0.0, 0.0), [0.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(from_face_axes(0.0, 0.0, 0.3), [0.0, 0.0, -0.3], atol=1e-12)


@given(ANGLES)
def test_quaternions_and_matrices_are_the_same_rotations(angles):
    turn = euler_to_matrix(*angles)
    np.testing.assert_allclose(from_quaternion(*to_quaternion(turn)), turn, atol=1e-9)


# Open Sound Control


def test_a_message_is_what_the_specification_of_osc_says():
    """The second example of the specification of OSC 1.0."""
    wanted = bytes.fromhex("2f666f6f000000002c69697366660000000003e8ffffffff68656c6c6f0000003f9df3b640b5b22d")
    assert osc.encode_message("/foo", 1000, -1, "hello", 1.234, 5.678) == wanted
    (message,) = osc.decode(wanted)
    assert message.address == "/foo" and message.arguments[:3] == (1000, -1, "hello")
    np.testing.assert_allclose(message.arguments[3:], (1.234, 5.678), rtol=1e-6)


@given(
    st.lists(
        st.one_of(
            st.integers(-(2**30), 2**30),
            st.floats(-1e3, 1e3, width=32),
            st.booleans(),
            st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9),
        ),
        max_size=6,
    )
)
def test_messages_agree_with_another_library(arguments):
    built = OscMessageBuilder("/a/b")
    for argument in arguments:
        built.add_arg(argument)
    ours = osc.encode_message("/a/b", *arguments)
    assert ours == built.build().dgram
    (message,) = osc.decode(ours)
    assert list(message.arguments) == arguments


def test_bundles_agree_with_another_library_nested_ones_too():
    inner, outer = OscBundleBuilder(IMMEDIATELY), OscBundleBuilder(IMMEDIATELY)
    for number in range(3):
        message = OscMessageBuilder("/n")
        message.add_arg(number)
        inner.add_content(message.build())
    outer.add_content(inner.build())
    outer.add_content(OscMessageBuilder("/last").build())
    found = osc.decode(outer.build().dgram)
    assert [m.address for m in found] == ["/n"] * 3 + ["/last"] and found[2].arguments == (2,)
    ours = list(osc.encode_bundles([osc.encode_message("/n", n) for n in range(9)], 80))
    assert len(ours) == 3 and all(len(bundle) <= 80 for bundle in ours)
    theirs = [timed.message.params[0] for bundle in ours for timed in OscPacket(bundle).messages]
    assert theirs == list(range(9))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"/a\0\0",
        b"/a\0\0,i\0\0",
        b"/a\0\0,f\0\0" + struct.pack(">f", float("nan")),
        b"/a\0\0,f\0\0" + struct.pack(">f", float("inf")),
        b"/a\0\0,q\0\0\0\0\0\0",
        b"/a\0\0,i\0\0\0\0\0\1\0\0\0\0",
        b"/a\0x,\0\0\0",
        b"abc\0,\0\0\0",
        b"/\xff\0\0,\0\0\0",
        b"#bundle\0",
        b"#bundle\0" + bytes(8) + struct.pack(">i", 2**31 - 1),
        b"#bundle\0" + bytes(8) + struct.pack(">i", -4) + bytes(8),
        b"/a\0\0,\0\0\0" * (MAX_DATAGRAM // 8 + 1),
    ],
)
def test_what_is_not_osc_is_refused(data):
    with pytest.raises(PacketError):
        osc.decode(data)


def test_bundles_in_bundles_have_an_end():
    data = osc.encode_message("/a")
    for _ in range(6):
        data = next(osc.encode_bundles([data], 9999))
    with pytest.raises(PacketError):
        osc.decode(data)


# Live Link Face


def golden_live_link(values=None, *, version=6, count=61) -> bytes:
    """A packet by the published layout: version, device, subject, time, rate, count and floats."""
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
    np.testing.assert_allclose(frame.face.rotation, from_face_axes(pitch, yaw, roll), atol=1e-6)


@pytest.mark.parametrize(("unit", "scale"), [("radians", 1.0), ("degrees", np.pi / 180.0), ("half-turns", np.pi)])
def test_the_unit_of_live_link_faces_angles_can_be_chosen(unit, scale):
    (frame,) = LiveLinkDecoder(unit).decode(golden_live_link([0.0] * 52 + [0.0, 0.25, 0.0] + [0.0] * 6))
    assert frame.face.rotation[0] == pytest.approx(0.25 * scale, abs=1e-6)


def test_live_link_face_without_values_has_no_face():
    assert LiveLinkDecoder().decode(golden_live_link())[0].face is None


@given(SHARES, ANGLES, st.floats(0.0, 1e5))
def test_live_link_face_goes_there_and_back(values, angles, time):
    face = FaceValues(np.array(values), np.array(angles))
    (frame,) = LiveLinkDecoder().decode(live_link.encode(face, time, subject="a", device="b"))
    np.testing.assert_allclose(frame.face.coefficients, values, atol=1e-7)
    np.testing.assert_allclose(frame.face.rotation, angles, atol=1e-5)
    assert frame.time == pytest.approx(time, abs=1e-4)


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
def test_wrong_packets_of_live_link_face_are_refused(data):
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
        "",
        "hello",
        FIRST.replace("=head#-21.5", "=head#nan"),
        FIRST.replace("=head#-21.5", "=head#1e999"),
        FIRST.replace("-21.5,-6.0,", ""),
        FIRST.replace("=head#", "=neck#"),
        FIRST.replace("jawOpen-12", "jawOpen-1" + "2" * 30),
        FIRST.replace("jawOpen-12", "jawOpen-x"),
        FIRST + "a" * 20_000,
        "|".join(["jawOpen-1"] * 1000),
        "jawOpen-1|=head#0,0,0,0,0,0|",
        FIRST.replace("custom", "cust\u00f6m"),
    ],
)
def test_wrong_packets_of_ifacialmocap_are_refused(text):
    with pytest.raises(PacketError):
        IFacialMocapDecoder().decode(text.encode())


def test_the_phone_is_asked_in_its_own_words():
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
    np.testing.assert_allclose(frame.face.rotation, from_face_axes(*np.radians([10.0, -20.0, 5.0])), atol=1e-9)
    meow = [{"k": name.replace("Left", "_L").replace("Right", "_R"), "v": 0.25} for name in COEFFICIENTS]
    meow = [entry for entry in meow if "_" in entry["k"]] + [{"k": "unknown", "v": 1}]
    (frame,) = VTubeStudioDecoder().decode(golden_vtube_studio(BlendShapes=meow))
    assert value_of(frame.face, "eyeBlinkLeft") == 0.25


def test_vtube_studio_says_when_there_is_no_face():
    assert VTubeStudioDecoder().decode(golden_vtube_studio(FaceFound=False))[0].face is None


def test_the_request_is_the_documented_one():
    asked = json.loads(vtube_studio.request(50_000))
    assert asked["messageType"] == "iOSTrackingDataRequest" and asked["ports"] == [50_000]
    assert 0.5 <= asked["time"] <= 10.0 and 1 <= len(asked["sentBy"]) <= 32


@pytest.mark.parametrize(
    "data",
    [
        b"{",
        b"{}",
        b"[" * 10_000,
        b'{"a":' * 5_000,
        golden_vtube_studio(Rotation={"x": 1e400, "y": 0, "z": 0}).replace(b"Infinity", b"1e400"),
        golden_vtube_studio(Rotation={"x": "1", "y": 0, "z": 0}),
        golden_vtube_studio(Rotation=[1, 2, 3]),
        golden_vtube_studio(BlendShapes=[]),
        golden_vtube_studio(BlendShapes=[{"k": "JawOpen"}] * 20),
        golden_vtube_studio(BlendShapes=[{"k": "JawOpen", "v": True}] * 20),
        golden_vtube_studio(Timestamp=-1),
        golden_vtube_studio(FaceFound=1),
        golden_vtube_studio() + b" " * MAX_DATAGRAM,
        golden_vtube_studio() + b"x",
    ],
)
def test_wrong_packets_of_vtube_studio_are_refused(data):
    with pytest.raises(PacketError):
        VTubeStudioDecoder().decode(data)


# VMC


def test_vmc_takes_arkits_names_of_any_case_and_the_heads_bone():
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


def test_vmc_takes_vrms_names_where_there_are_no_others():
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
def test_vmc_goes_there_and_back_in_bundles_that_fit_a_packet_and_applies_last(values, angles):
    bundles = list(vmc.encode(FaceValues(np.array(values), np.array(angles)), 1.5))
    assert len(bundles) > 1 and all(len(bundle) <= 1400 for bundle in bundles)
    addresses = [timed.message.address for bundle in bundles for timed in OscPacket(bundle).messages]
    assert addresses[-1] == "/VMC/Ext/Blend/Apply" and addresses.count("/VMC/Ext/Blend/Apply") == 1
    decoder = VmcDecoder()
    frames = [frame for bundle in bundles for frame in decoder.decode(bundle)]
    assert len(frames) == 1
    np.testing.assert_allclose(frames[0].face.coefficients, values, atol=1e-7)
    np.testing.assert_allclose(frames[0].face.rotation, angles, atol=1e-6)


def test_vmc_sends_vrm_0_and_vrm_1_names_as_well_in_their_own_case():
    coefficients = np.zeros(N_COEFFICIENTS)
    coefficients[COEFFICIENT_INDEX["eyeBlinkLeft"]] = 0.75
    sent = {
        timed.message.params[0]: timed.message.params[1]
        for bundle in vmc.encode(FaceValues(coefficients, np.zeros(3)), 0.0)
        for timed in OscPacket(bundle).messages
        if timed.message.address.endswith("Val")
    }
    assert sent["Blink_L"] == sent["blinkLeft"] == sent["EyeBlinkLeft"] == 0.75
    assert {"A", "aa", "Joy", "happy"} <= sent.keys()


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
def test_wrong_messages_of_vmc_are_refused(message):
    with pytest.raises(PacketError):
        VmcDecoder().decode(message)


def test_vmc_remembers_a_limited_number_of_names():
    decoder = VmcDecoder()
    with pytest.raises(PacketError):
        for number in range(1000):
            decoder.decode(osc.encode_message("/VMC/Ext/Blend/Val", f"name{number}", 0.5))


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


@pytest.mark.parametrize(
    "message",
    [
        osc.encode_message("/W", 52, 0.5),
        osc.encode_message("/W", -1, 0.5),
        osc.encode_message("/W", True, 0.5),
        osc.encode_message("/W", 1),
        osc.encode_message("/HR", 1.0, 2.0),
        osc.encode_message("/HR", 1.0, 2.0, "x"),
        osc.encode_message("/X", 1.0),
    ],
)
def test_wrong_messages_of_face_cap_are_refused(message):
    with pytest.raises(PacketError):
        FaceCapDecoder().decode(message)


# OpenSeeFace


def golden_openseeface(points, places, *, found=1) -> bytes:
    """A packet by the layout of OpenSeeFace's own receiver, for 68 points in the image and 70 on the face."""
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
        # The inner corners stand for the outer ones, which do not come.
        number = theirs.index({48: 60, 54: 64}.get(ibug, ibug))
        np.testing.assert_allclose(frame.face.landmarks[ours], points[number], rtol=1e-6)
        np.testing.assert_allclose(frame.face.shape[ours] * 0.74, places[number] * (-1, 1, 1), rtol=1e-5)
    np.testing.assert_allclose(frame.face.landmarks[MOUTH_CORNERS], points[[58, 62]], rtol=1e-6)
    assert frame.subject == "3" and frame.time == 12.5


def test_openseeface_without_points_in_space_has_no_face():
    assert (
        OpenSeeFaceDecoder().decode(golden_openseeface(np.zeros((68, 2)), np.zeros((70, 3)), found=0))[0].face is None
    )


def test_several_faces_of_openseeface_are_told_apart():
    take = performance()
    one = openseeface.encode(take.result(0), 1.0)
    other = one[:8] + struct.pack("<i", 7) + one[12:]
    assert [frame.subject for frame in OpenSeeFaceDecoder().decode(one + other)] == ["0", "7"]


@given(ANGLES, st.floats(30.0, 300.0), st.floats(0.0, 1200.0), st.floats(0.0, 700.0))
def test_the_pose_is_found_in_points_without_it(angles, scale, x, y):
    shape = coefficient_face().neutral.shape
    landmarks = scale * (shape @ euler_to_matrix(*angles).T)[:, :2] + (x, y)
    pose = fit_pose(shape, landmarks)
    np.testing.assert_allclose(pose, [scale, *angles, x, y], atol=1e-6)


def test_openseeface_goes_there_and_back():
    take = performance()
    for frame in (0, 20, 40):
        result = take.result(frame)
        result = replace(result, landmarks=project(result.shape[None], result.pose[None])[0])
        (found,) = OpenSeeFaceDecoder().decode(openseeface.encode(result, 3.0))
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
    (found,) = OpenSeeFaceDecoder().decode(openseeface.encode(result, 0.0))
    np.testing.assert_allclose(found.face.gaze, result.gaze, atol=1e-4)
    assert found.face.vergence == pytest.approx(result.vergence, abs=1e-4)


def test_a_frontal_face_has_the_rotation_that_openseefaces_receivers_expect():
    """They take 90 degrees from z, and turn x by 180; what is left is straight ahead, in front of the camera."""
    values, angles = np.zeros(N_COEFFICIENTS), np.array([0.01, 0.01, 0.01])
    data = openseeface.encode(coefficient_face().result(values, angles), 0.0)
    x, y, z, *moved = struct.unpack_from("<6f", data, 8 + 4 + 8 + 8 + 1 + 4 + 16)
    assert abs(x) == pytest.approx(180.0, abs=1.0)
    assert y == pytest.approx(0.0, abs=1.0) and z == pytest.approx(90.0, abs=1.0)
    assert -moved[2] > 0.0


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d[:-1],
        lambda d: d + b"\0",
        lambda d: d * 5,
        lambda d: b"",
        lambda d: d[:28] + b"\7" + d[29:],
        lambda d: d[:73] + struct.pack("<f", float("nan")) + d[77:],
        lambda d: d[:500] + struct.pack("<f", 1e30) + d[504:],
        lambda d: d[:-900] + bytes(844) + d[-56:],
    ],
)
def test_wrong_packets_of_openseeface_are_refused(change):
    data = openseeface.encode(performance().result(0), 1.0)
    with pytest.raises(PacketError):
        OpenSeeFaceDecoder().decode(change(data))


# Facemime's own


def own(result, sequence=7, time=2.5) -> bytes:
    kind, body = datagram.encode_face(result)
    return datagram.pack(datagram.Packet(kind, b"sessions", sequence, time, body), signed=False)


def test_an_own_packet_is_laid_out_as_documented():
    take = performance()
    data = own(take.result(0))
    assert data[:8] == b"FMIM\1\1\0\0" and data[8:16] == b"sessions" and len(data) == 482
    assert struct.unpack(">Qd", data[16:32]) == (7, 2.5)
    np.testing.assert_allclose(struct.unpack(">6f", data[32:56]), take.pose[0], rtol=1e-6)
    shape = np.frombuffer(data, ">i2", 198, 56).reshape(66, 3) / 8192.0
    np.testing.assert_allclose(shape, take.shape[0], atol=2.0**-14)


def test_30_frames_a_second_take_at_most_150_kilobits_with_all_headers():
    for result in (performance().result(0), coefficient_face().result(distinct(), np.zeros(3))):
        bytes_sent = len(own(result)) + 16 + 28  # the signature, and the headers of UDP and IP
        assert 30 * 8 * bytes_sent <= 150_000


def test_landmarks_come_back_to_a_step_of_a_take():
    take = performance()
    for number in range(0, len(take), 7):
        result = take.result(number)
        frame = datagram.decode_face(datagram.unpack(own(result, number, 0.1 * number)))
        assert frame.sequence == number and frame.time == 0.1 * number
        if not result.found:
            assert frame.face is None
            continue
        np.testing.assert_allclose(frame.face.shape, result.shape, atol=2.0**-14)
        np.testing.assert_allclose(frame.face.pose, result.pose, rtol=1e-6)
        assert np.isnan(frame.face.gaze).all() and np.isnan(frame.face.actions).all()


@given(SHARES, ANGLES)
def test_coefficients_come_back_to_a_step_of_16_bits(values, angles):
    result = coefficient_face().result(np.array(values), np.array(angles))
    found = datagram.decode_face(datagram.unpack(own(result))).face
    np.testing.assert_allclose(found.coefficients, values, atol=0.6 / 65535.0)
    np.testing.assert_allclose(found.pose, result.pose, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("size", [0, 3, 31, 481])
def test_own_packets_that_are_cut_or_longer_are_refused(size):
    data = own(performance().result(0))
    for wrong in (
        data[:size],
        data + b"\0",
        b"X" + data[1:],
        data[:4] + b"\2" + data[5:],
        data[:6] + b"\0\2" + data[8:],
    ):
        with pytest.raises(PacketError):
            datagram.unpack(wrong)


@pytest.mark.parametrize(("at", "value"), [(32, np.nan), (32, -1.0), (36, np.inf), (44, 50.0), (48, 1e9)])
def test_own_packets_with_impossible_poses_are_refused(at, value):
    data = own(performance().result(0))
    with pytest.raises(PacketError):
        datagram.decode_face(datagram.unpack(data[:at] + struct.pack(">f", value) + data[at + 4 :]))


def test_an_own_packet_with_an_unknown_landmark_is_refused():
    data = own(performance().result(0))
    with pytest.raises(PacketError):
        datagram.decode_face(datagram.unpack(data[:56] + b"\x80\0" + data[58:]))
