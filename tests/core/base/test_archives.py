"""Numpy archives are read within bounds, and every problem is a ValueError."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from facemime.core.base.archives import MAX_BYTES, MAX_MEMBERS, read_archive


def packed(**arrays) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def npy(header: bytes, content: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content


def stated(descr: str, shape: str) -> bytes:
    return f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()


def test_numpy_archives_are_read():
    arrays = {"a": np.arange(12.0).reshape(3, 4), "b": np.asfortranarray(np.arange(6).reshape(2, 3))}
    arrays |= {
        "name": np.array("head"),
        "names": np.array(["x", "yy"]),
        "on": np.array([True]),
        "none": np.empty((0, 3)),
    }
    archive = read_archive(packed(**arrays, raw=np.frombuffer(b"net", np.uint8)))
    np.testing.assert_array_equal(archive.floats("a", (None, 4)), arrays["a"])
    np.testing.assert_array_equal(archive.integers("b", (2, 3), 0, 5), arrays["b"])
    assert archive.text("name") == "head" and archive.texts("names") == ("x", "yy")
    assert archive.flags("on", (1,)).tolist() == [True] and archive.data("raw") == b"net"
    assert archive.floats("none", (None, 3)).shape == (0, 3)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("bytes, no array", b"hello"),
        ("a header that ends early", npy(b"{'descr': '<f4', 'shape': (6,")),
        ("a header without end", npy(b"(" * 400)),
        ("an object", npy(stated("|O", "(3,)"), bytes(24))),
        ("a negative side", npy(stated("<f4", "(-1, 3)"), bytes(12))),
        ("more than there is", npy(stated("<f4", "(400000000, 3)"), bytes(12))),
        ("more than can be counted", npy(stated("<f8", "(9223372036854775807, 9)"))),
        ("a long text", npy(stated("<U900000000", "()"))),
        ("nothing, of any length", npy(stated("<f4", "(0, 9223372036854775807)"))),
        ("invalid characters", npy(stated("<U1", "()"), b"\xff" * 4)),
        ("invalid characters, the other way round", npy(stated(">U2", "(1,)"), b"\xff" * 8)),
        ("texts without letters", npy(stated("<U0", "(3,)"))),
        ("an unknown type", npy(stated("<f7", "(1,)"), bytes(7))),
    ],
)
def test_a_member_that_is_not_an_array_is_refused(name, content):
    with pytest.raises(ValueError, match="member"):
        read_archive(zipped({"a.npy": content}))


def test_other_files_duplicates_and_too_many_members_are_refused():
    good = npy(stated("<f4", "(1,)"), bytes(4))
    with pytest.raises(ValueError, match="not a numpy array"):
        read_archive(zipped({"readme.txt": b"hello"}))
    with pytest.warns(UserWarning, match="Duplicate"):
        doubled = io.BytesIO()
        with zipfile.ZipFile(doubled, "w") as archive:
            archive.writestr("a.npy", good)
            archive.writestr("a.npy", good)
    with pytest.raises(ValueError, match="same name"):
        read_archive(doubled.getvalue())
    with pytest.raises(ValueError, match="members"):
        read_archive(zipped({f"{i}.npy": good for i in range(MAX_MEMBERS + 1)}))


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_unusual_compression_is_refused(method):
    with pytest.raises(ValueError, match="compressed in a way that numpy does not use"):
        read_archive(zipped({"a.npy": npy(stated("<f4", "(1,)"), bytes(4))}, method))


@pytest.mark.parametrize("place", [6, 8])
def test_an_encrypted_or_unknown_member_is_refused(place):
    """Byte 6 of a member's header and byte 8 of the directory's are the flags; the method follows after two bytes."""
    data = bytearray(packed(a=np.zeros(3)))
    for marker, shift in ((b"PK\x03\x04", 0), (b"PK\x01\x02", 2)):
        data[data.find(marker) + place + shift] |= 0x41
    with pytest.raises(ValueError, match="encrypted"):
        read_archive(bytes(data))


def test_a_damaged_stream_is_refused():
    data = bytearray(packed(a=np.arange(1000.0)))
    data[60] ^= 0xFF
    with pytest.raises(ValueError, match="damaged"):
        read_archive(bytes(data))
    with pytest.raises(ValueError, match="damaged"):
        read_archive(b"no archive")


def test_a_zip_bomb_is_refused_before_unpacking():
    bomb = packed(a=np.zeros(MAX_BYTES, np.uint8))
    assert len(bomb) < 100_000
    tracemalloc.start()
    with pytest.raises(ValueError, match="unpacks to"):
        read_archive(bomb)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


def test_a_member_longer_than_the_archive_states_is_refused():
    data = bytearray(packed(a=np.zeros(100_000)))
    at = data.find(b"PK\x01\x02") + 24
    data[at : at + 4] = struct.pack("<I", 200)
    with pytest.raises(ValueError, match=r"damaged|not as long"):
        read_archive(bytes(data))


def test_an_array_of_the_wrong_kind_is_refused():
    archive = read_archive(
        packed(a=np.array([1.0, np.nan]), i=np.array([7]), t=np.array(["x", "x"]), big=np.array([1e300]))
    )
    for ask, message in [
        (lambda: archive.floats("b", (1,)), "b is missing"),
        (lambda: archive.floats("a", (2,)), "not finite"),
        (lambda: archive.floats("big", (1,), np.float32), "not finite"),
        (lambda: archive.floats("i", (2,)), "shape"),
        (lambda: archive.integers("a", (2,), 0, 9), "type"),
        (lambda: archive.integers("i", (1,), 0, 6), "within 0 to 6"),
        (lambda: archive.flags("i", (1,)), "type"),
        (lambda: archive.data("i"), "type"),
        (lambda: archive.texts("t"), "duplicate"),
    ]:
        with pytest.raises(ValueError, match=message):
            ask()
    assert archive.text("i") == archive.text("t") == archive.text("gone") == ""
