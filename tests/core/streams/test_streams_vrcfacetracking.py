"""Parameters are read as VRCFaceTracking's own formulas make them, whichever of them an avatar has."""

import numpy as np
import pytest

from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS
from facemime.core.streams.protocols import osc
from facemime.core.streams.protocols.frames import PacketError
from facemime.core.streams.protocols.vrcfacetracking import VrcFaceTrackingDecoder
from tests.helpers.stream_values import value_of

PREFIX = "/avatar/parameters/v2/"


def bundle(values: dict[str, float | bool], prefix: str = PREFIX) -> bytes:
    """A datagram as VRCFaceTracking sends one for all parameters that changed."""
    messages = [osc.encode_message(name if name[0] == "/" else prefix + name, value) for name, value in values.items()]
    (data,) = osc.encode_bundles(messages, 10_000)
    return data


def face_of(values: dict[str, float | bool], prefix: str = PREFIX):
    (frame,) = VrcFaceTrackingDecoder().decode(bundle(values, prefix))
    return frame.face


def sent(smile=0.0, frown=0.0, lid=1.0, wide=0.0, jaw_right=0.0, jaw_left=0.0) -> dict[str, dict[str, float]]:
    """The parameters of one face in three avatars, by VRCFaceTracking's formulas for them."""
    return {
        "single": {
            "MouthCornerPullLeft": smile,
            "MouthCornerSlantLeft": smile,
            "MouthFrownLeft": frown,
            "EyeClosedLeft": 1.0 - lid,
            "EyeWideLeft": wide,
            "JawRight": jaw_right,
            "JawLeft": jaw_left,
        },
        "combined": {
            "SmileFrownLeft": smile - frown,
            "EyeLidLeft": 0.75 * lid + 0.25 * wide,
            "JawX": jaw_right - jaw_left,
        },
        "most combined": {
            "SmileFrown": smile - frown,
            "EyeOpen": lid,
            "EyeWide": wide,
            "JawX": jaw_right - jaw_left,
        },
    }


@pytest.mark.parametrize("avatar", ["single", "combined", "most combined"])
@pytest.mark.parametrize(
    "face",
    [
        {"smile": 0.6, "lid": 0.4, "jaw_right": 0.3},
        {"frown": 0.5, "wide": 0.8, "jaw_left": 0.7},
        {"lid": 0.0},
        {},
    ],
)
def test_every_avatar_gives_the_same_face(avatar, face):
    found = face_of(sent(**face)[avatar])
    assert value_of(found, "mouthSmileLeft") == pytest.approx(face.get("smile", 0.0), abs=1e-6)
    assert value_of(found, "mouthFrownLeft") == pytest.approx(face.get("frown", 0.0), abs=1e-6)
    assert value_of(found, "eyeBlinkLeft") == pytest.approx(1.0 - face.get("lid", 1.0), abs=1e-6)
    assert value_of(found, "eyeWideLeft") == pytest.approx(face.get("wide", 0.0), abs=1e-6)
    assert value_of(found, "jawRight") == pytest.approx(face.get("jaw_right", 0.0), abs=1e-6)
    assert value_of(found, "jawLeft") == pytest.approx(face.get("jaw_left", 0.0), abs=1e-6)


@pytest.mark.parametrize("prefix", [PREFIX, "/avatar/parameters/FT/v2/", "/avatar/parameters/My/Own/v2/"])
def test_the_prefix_of_an_avatar_does_not_matter(prefix):
    assert value_of(face_of({"JawOpen": 0.5}, prefix), "jawOpen") == pytest.approx(0.5)


@pytest.mark.parametrize("bits", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("value", [0.0, 0.2, 0.55, 0.999, 1.0, -0.4, -1.0])
def test_parameters_in_bits_are_put_together(bits, value):
    whole = 2**bits - 1 if abs(value) > 0.99999 else int(abs(value) * 2**bits)
    values = {f"JawX{1 << place}": bool(whole >> place & 1) for place in range(bits)} | {"JawXNegative": value < 0.0}
    found = face_of(values)
    towards, away = ("jawLeft", "jawRight") if value < 0.0 else ("jawRight", "jawLeft")
    assert value_of(found, towards) == pytest.approx(abs(value), abs=1.0 / 2**bits)
    assert value_of(found, away) == 0.0


def test_the_eyes_look_right_and_up_where_the_parameters_are_positive():
    face = face_of({"EyeLeftX": 0.2, "EyeRightX": 0.1, "EyeY": 0.3})
    np.testing.assert_allclose(np.sin(face.eyes), [[-0.3, 0.1], [-0.3, 0.2]], atol=1e-6)
    assert value_of(face, "eyeLookInLeft") > 0.2 and value_of(face, "eyeLookOutRight") > 0.1
    assert value_of(face, "eyeLookUpLeft") > 0.4 and value_of(face, "eyeLookDownLeft") == 0.0


def test_vrchats_own_gaze_is_in_degrees_down_and_to_the_right():
    data = osc.encode_message("/tracking/eye/LeftRightPitchYaw", -15.0, 20.0, -14.0, 18.0)
    (frame,) = VrcFaceTrackingDecoder().decode(b"".join(osc.encode_bundles([data], 1000)))
    np.testing.assert_allclose(np.degrees(frame.face.eyes), [[-14.0, 18.0], [-15.0, 20.0]], atol=1e-5)


def test_without_bundles_a_frame_ends_when_a_parameter_comes_again():
    decoder, frames = VrcFaceTrackingDecoder(), []
    for step in range(4):
        for name in ("JawOpen", "MouthClosed", "TongueOut"):
            frames += decoder.decode(osc.encode_message(PREFIX + name, 0.25 * step))
    assert [value_of(frame.face, "jawOpen") for frame in frames] == [0.0, 0.25, 0.5]
    assert all(value_of(frame.face, "tongueOut") == value_of(frame.face, "jawOpen") for frame in frames)


def test_parameters_that_did_not_change_keep_their_values():
    decoder = VrcFaceTrackingDecoder()
    decoder.decode(bundle({"JawOpen": 0.5, "TongueOut": 0.25}))
    (frame,) = decoder.decode(bundle({"TongueOut": 0.75}))
    assert value_of(frame.face, "jawOpen") == 0.5 and value_of(frame.face, "tongueOut") == 0.75


def test_there_is_no_face_while_nothing_is_tracked():
    decoder = VrcFaceTrackingDecoder()
    off = {"/avatar/parameters/EyeTrackingActive": False, "/avatar/parameters/LipTrackingActive": False}
    assert decoder.decode(bundle(off | {"JawOpen": 0.5}))[0].face is None
    assert decoder.decode(bundle({"/avatar/parameters/FT/LipTrackingActive": True}))[0].face is not None


def test_values_that_change_are_a_face_even_if_the_sender_states_that_nothing_is_tracked():
    decoder, frames = VrcFaceTrackingDecoder(), []
    for name in ("EyeTrackingActive", "LipTrackingActive"):
        decoder.decode(osc.encode_message(f"/avatar/parameters/{name}", False))
    for step in range(20):
        frames += decoder.decode(bundle({"JawOpen": 0.05 * step}))
    assert [frame.face is not None for frame in frames] == [False] * 5 + [True] * 15
    still = [decoder.decode(bundle({"JawOpen": 0.95}))[0].face for _ in range(3)]
    assert all(face is not None for face in still)
    decoder.decode(osc.encode_message("/avatar/parameters/LipTrackingActive", False))
    assert decoder.decode(bundle({"JawOpen": 0.0}))[0].face is None


@pytest.mark.parametrize(
    ("sent", "wanted"),
    [
        ({"LeftEyeLid": 0.25, "RightEyeLid": 1.0}, {"eyeBlinkLeft": 0.75}),
        ({"LeftEyeLidExpanded": 0.4, "RightEyeLidExpanded": 0.8}, {"eyeBlinkLeft": 0.5}),
        ({"CombinedEyeLidExpandedSqueeze": 0.9}, {"eyeWideLeft": 0.5, "eyeWideRight": 0.5}),
        (
            {"LeftEyeLidExpandedSqueeze": -0.5, "RightEyeLidExpandedSqueeze": 0.8},
            {"eyeBlinkLeft": 1.0, "eyeSquintLeft": 0.5},
        ),
        ({"MouthPout": 0.5, "MouthApeShape": 0.25}, {"mouthPucker": 0.5, "mouthClose": 0.25}),
        ({"SmileSadLeft": 0.5, "SmileSadRight": -0.5}, {"mouthSmileLeft": 0.5, "mouthFrownRight": 0.5}),
        ({"JawOpen": 0.5, "PuffSuckLeft": 0.5, "PuffSuckRight": 0.5}, {"jawOpen": 0.5, "cheekPuff": 0.5}),
    ],
)
def test_parameters_of_version_4_of_the_program_are_read(sent, wanted):
    face = face_of(sent, "/avatar/parameters/")
    shown = {name: value for name, value in zip(COEFFICIENTS, face.coefficients, strict=True) if value > 1e-6}
    assert shown == {name: pytest.approx(value) for name, value in wanted.items()}


def test_eyes_of_version_4_look_right_and_up_where_the_parameters_are_positive():
    face = face_of({"LeftEyeX": 0.25, "RightEyeX": 0.25, "EyesY": 0.125}, "/avatar/parameters/")
    np.testing.assert_allclose(face.eyes, face_of({"EyeX": 0.25, "EyeY": 0.125}).eyes)


def test_other_parameters_of_an_avatar_are_left_out():
    decoder = VrcFaceTrackingDecoder()
    for data in (
        osc.encode_message("/avatar/change", "avtr_1"),
        osc.encode_message("/avatar/parameters/VelocityX", 0.5),
        osc.encode_message(PREFIX + "Head/Yaw", 0.5),
        osc.encode_message(PREFIX + "JawOpen3", True),
        osc.encode_message(PREFIX + "JawOpen"),
        bundle({"MyHat": True}, "/avatar/parameters/"),
    ):
        assert decoder.decode(data) == []


def test_messages_of_other_protocols_are_refused():
    with pytest.raises(PacketError):
        VrcFaceTrackingDecoder().decode(osc.encode_message("/VMC/Ext/Blend/Val", "JawOpen", 0.5))


def test_coefficients_without_parameters_are_zero():
    face = face_of({"JawOpen": 1.0})
    assert np.flatnonzero(face.coefficients).tolist() == [COEFFICIENT_INDEX["jawOpen"]] and face.eyes is None
