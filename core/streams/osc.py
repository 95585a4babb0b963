"""Open Sound Control 1.0: messages and bundles, as far as face-tracking programs use them.

The specification is at opensoundcontrol.stanford.edu. Integers and floats are big-endian, and everything is padded to
four bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from math import isfinite
from typing import NamedTuple

from .frames import MAX_DATAGRAM, PacketError

Argument = int | float | str | bool
_BUNDLE = b"#bundle\0"
_NOW = struct.pack(">Q", 1)
"""The time tag for "immediately"."""
_NUMBERS = {"i": struct.Struct(">i"), "f": struct.Struct(">f"), "h": struct.Struct(">q"), "d": struct.Struct(">d")}
_FLAGS = {"T": True, "F": False}
_SIZE = struct.Struct(">i")
_MAX_DEPTH, _MAX_MESSAGES, _MAX_ARGUMENTS = 4, 512, 32


class Message(NamedTuple):
    """An OSC message: its address and arguments."""

    address: str
    arguments: tuple[Argument, ...]


def encode_message(address: str, *arguments: Argument) -> bytes:
    """Encode a message.

    Parameters
    ----------
    address : str
        Address, which begins with a slash.
    arguments : int, float, str or bool
        Arguments, of types i, f, s, T and F.

    Returns
    -------
    bytes
        The message.
    """
    tags, body = ",", b""
    for value in arguments:
        if isinstance(value, bool):
            tags += "T" if value else "F"
        elif isinstance(value, str):
            tags, body = tags + "s", body + _padded(value)
        else:
            tag = "i" if isinstance(value, int) else "f"
            tags, body = tags + tag, body + _NUMBERS[tag].pack(value)
    return _padded(address) + _padded(tags) + body


def encode_bundles(messages: Iterable[bytes], limit: int) -> Iterator[bytes]:
    """Pack messages into bundles, in order.

    Parameters
    ----------
    messages : iterable of bytes
        Messages from `encode_message`.
    limit : int
        Largest size of a bundle in bytes; a bundle with a single message may be larger.

    Yields
    ------
    bytes
        A bundle.
    """
    bundle = empty = _BUNDLE + _NOW
    for message in messages:
        if bundle is not empty and len(bundle) + 4 + len(message) > limit:
            yield bundle
            bundle = empty
        bundle = bundle + _SIZE.pack(len(message)) + message
    if bundle is not empty:
        yield bundle


def is_bundle(data: bytes) -> bool:
    """Return whether a datagram is a bundle rather than a single message."""
    return data.startswith(_BUNDLE)


def decode(data: bytes) -> list[Message]:
    """Decode a datagram; PacketError if any part of it is not OSC, or a number in it is not finite."""
    found: list[Message] = []
    _decode(data, found, 0)
    return found


def _decode(data: bytes, found: list[Message], depth: int) -> None:
    if not 8 <= len(data) <= MAX_DATAGRAM or len(data) % 4 or depth > _MAX_DEPTH or len(found) >= _MAX_MESSAGES:
        raise PacketError("not OSC")
    if not is_bundle(data):
        found.append(_message(data))
        return
    at = 16
    while at < len(data):
        if at + 4 > len(data):
            raise PacketError("a bundle is truncated")
        (size,) = _SIZE.unpack_from(data, at)
        if size < 8 or at + 4 + size > len(data):
            raise PacketError("a bundle is truncated")
        _decode(data[at + 4 : at + 4 + size], found, depth + 1)
        at += 4 + size
    if len(data) < 16:
        raise PacketError("a bundle is truncated")


def _message(data: bytes) -> Message:
    address, at = _text(data, 0)
    tags, at = _text(data, at)
    if not address.startswith("/") or not tags.startswith(",") or len(tags) > _MAX_ARGUMENTS + 1:
        raise PacketError("not an OSC message")
    arguments: list[Argument] = []
    for tag in tags[1:]:
        value: Argument
        if tag == "s":
            value, at = _text(data, at)
        elif tag in _FLAGS:
            value = _FLAGS[tag]
        elif (kind := _NUMBERS.get(tag)) is not None and at + kind.size <= len(data):
            (value,), at = kind.unpack_from(data, at), at + kind.size
            if not isfinite(float(value)):
                raise PacketError("a number is not finite")
        else:
            raise PacketError("an OSC argument is missing or of an unknown type")
        arguments.append(value)
    if at != len(data):
        raise PacketError("something follows an OSC message")
    return Message(address, tuple(arguments))


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return the text at byte `at`, and the byte after its padding."""
    end = data.find(b"\0", at)
    after = (end | 3) + 1
    if end < 0 or after > len(data) or data[end:after].strip(b"\0"):
        raise PacketError("an OSC text does not end")
    try:
        return data[at:end].decode("utf-8"), after
    except UnicodeDecodeError:
        raise PacketError("an OSC text is not UTF-8") from None


def _padded(text: str) -> bytes:
    raw = text.encode("utf-8") + b"\0"
    return raw + bytes(-len(raw) % 4)
