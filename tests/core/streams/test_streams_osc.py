"""Conversion of angles for streams, and Open Sound Control as specified."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

from facemime.core.face.rotation import euler_to_matrix, from_face_axes, to_face_axes, to_quaternion
from facemime.core.streams.protocols import osc
from facemime.core.streams.protocols.frames import MAX_DATAGRAM, PacketError, from_quaternion
from tests.helpers.stream_values import ANGLES

# Axes


@given(ANGLES)
def test_angles_about_the_axes_of_a_face_anchor_survive_conversion_and_back(angles):
    np.testing.assert_allclose(from_face_axes(*to_face_axes(np.array(angles))), angles, atol=1e-9)


def test_a_face_anchor_that_turns_to_the_performers_left_has_a_negative_yaw():
    """With y up and z towards the viewer, positive angles turn to the viewer's right, the performer's left."""
    np.testing.assert_allclose(from_face_axes(0.0, 0.3, 0.0), [0.0, -0.3, 0.0], atol=1e-12)
    np.testing.assert_allclose(from_face_axes(0.3, 0.0, 0.0), [0.3, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(from_face_axes(0.0, 0.0, 0.3), [0.0, 0.0, -0.3], atol=1e-12)


@given(ANGLES)
def test_quaternions_and_matrices_are_the_same_rotations(angles):
    turn = euler_to_matrix(*angles)
    np.testing.assert_allclose(from_quaternion(*to_quaternion(turn)), turn, atol=1e-9)


# Open Sound Control


def test_a_message_follows_the_specification_of_osc():
    """The second example of the specification of OSC 1.0."""
    wanted = bytes.fromhex("2f666f6f000000002c69697366660000000003e8ffffffff68656c6c6f0000003f9df3b640b5b22d")
    assert osc.encode_message("/foo", 1000, -1, "hello", 1.234, 5.678) == wanted
    (message,) = osc.decode(wanted)
    assert message.address == "/foo" and message.arguments[:3] == (1000, -1, "hello")
    np.testing.assert_allclose(message.arguments[3:], (1.234, 5.678), rtol=1e-6)


@pytest.mark.thorough
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


def test_bundles_agree_with_another_library_even_if_nested():
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


def test_the_nesting_of_bundles_is_limited():
    data = osc.encode_message("/a")
    for _ in range(6):
        data = next(osc.encode_bundles([data], 9999))
    with pytest.raises(PacketError):
        osc.decode(data)


def test_arguments_that_are_neither_numbers_nor_texts_are_none_and_those_after_them_are_read():
    built = OscMessageBuilder("/a")
    built.add_arg(b"12345", OscMessageBuilder.ARG_TYPE_BLOB)
    built.add_arg(None, OscMessageBuilder.ARG_TYPE_NIL)
    built.add_arg((1, 2, 3, 4), OscMessageBuilder.ARG_TYPE_MIDI)
    built.add_arg([0.5, ["x"]])
    built.add_arg(7)
    (message,) = osc.decode(built.build().dgram)
    assert message.arguments == (None, None, None, None, 0.5, None, "x", None, None, 7)


def test_a_message_of_old_programs_without_types_has_no_arguments():
    assert osc.decode(b"/address\0\0\0\0") == [osc.Message("/address", ())]


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        b"/a",
        b"/a\0\0,q\0\0\0\0\0\0",
        b"/a\0\0,f\0\0" + struct.pack(">f", float("nan")),
        b"/a\0\0,b\0\0" + struct.pack(">i", -8),
        b"/a\0\0,b\0\0" + struct.pack(">i", 2**31 - 1),
        b"/\x83\0\0,\0\0\0",
    ],
)
def test_a_damaged_message_in_a_bundle_is_left_out_alone(damaged):
    good = osc.encode_message("/good", 1)
    bundle = next(osc.encode_bundles([good, damaged, good], 9999))
    assert osc.decode(bundle) == [osc.Message("/good", (1,))] * 2
    with pytest.raises(PacketError):
        osc.decode(next(osc.encode_bundles([damaged], 9999)))
