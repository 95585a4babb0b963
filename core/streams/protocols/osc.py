"""Open Sound Control 1.0: messages and bundles, as far as face-tracking programs use them.

The specification is at opensoundcontrol.stanford.edu. Integers and floats are big-endian, and everything is padded to
four bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import isfinite
from typing import NamedTuple

from .frames import MAX_DATAGRAM, PacketError

Argument = int | float | str | bool | None
_BUNDLE = b"#bundle\0"
_NOW = struct.pack(">Q", 1)
"""The time tag for "immediately"."""
_NUMBERS = {"i": struct.Struct(">i"), "f": struct.Struct(">f"), "h": struct.Struct(">q"), "d": struct.Struct(">d")}
_FLAGS: dict[str, Argument] = {"T": True, "F": False, "N": None, "I": None, "[": None, "]": None}
_TEXTS = "sS"
_OTHER = {"t": 8, "c": 4, "r": 4, "m": 4}
"""Sizes in bytes of arguments that no program uses for faces."""
_SIZE = struct.Struct(">i")
_MAX_DEPTH = 4
"""Largest number of bundles that a message may be nested in."""
_MAX_MESSAGES = 512
"""Largest number of messages in a datagram."""
_MAX_ARGUMENTS = 32
"""Largest number of arguments of a message."""


class Message(NamedTuple):
    """An OSC message: its address and arguments, which are None if they are neither numbers nor texts."""

    address: str
    arguments: tuple[Argument, ...]


def encode_message(address: str, *arguments: Argument) -> bytes:
    """Encode a message to an address that begins with a slash; arguments are of types i, f, s, T and F."""
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
    """Pack messages from `encode_message` into bundles, in order.

    A bundle has at most `limit` bytes, unless it contains a single message.
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


def numbers(arguments: tuple[Argument, ...], count: int) -> tuple[float, ...]:
    """Return the first arguments as numbers, which some programs send as integers; PacketError for anything else."""
    values = [float(value) for value in arguments[:count] if isinstance(value, int | float)]
    if len(values) != count:
        raise PacketError("numbers are missing")
    return tuple(values)


def decode(data: bytes) -> list[Message]:
    """Decode a datagram without the messages of its bundles that are damaged; PacketError if nothing of it is OSC."""
    found: list[Message] = []
    if _decode(data, found, 0) and not found:
        raise PacketError("not OSC")
    return found


def read_each(data: bytes, read: Callable[[Message], bool]) -> None:
    """Let a decoder read the messages of a datagram, and leave out those that it cannot.

    `read` returns whether a message belongs to the protocol, and raises PacketError if it is malformed. Raises
    PacketError if no message belongs to the protocol, or all are malformed.
    """
    messages, known = decode(data), 0
    for message in messages:
        with suppress(PacketError):
            known += read(message)
    if messages and not known:
        raise PacketError("no message of this protocol")


def _decode(data: bytes, found: list[Message], depth: int) -> int:
    """Decode a message or a bundle; returns the number of messages that are damaged."""
    if not 8 <= len(data) <= MAX_DATAGRAM or depth > _MAX_DEPTH or len(found) >= _MAX_MESSAGES:
        raise PacketError("not OSC")
    if not is_bundle(data):
        found.append(_message(data))
        return 0
    if len(data) < 16:
        raise PacketError("a bundle is truncated")
    at, damaged = 16, 0
    while at < len(data):
        if at + 4 > len(data):
            raise PacketError("a bundle is truncated")
        (size,) = _SIZE.unpack_from(data, at)
        if size < 0 or at + 4 + size > len(data):
            raise PacketError("a bundle is truncated")
        try:
            damaged += _decode(data[at + 4 : at + 4 + size], found, depth + 1)
        except PacketError:
            damaged += 1
        at += 4 + size
    return damaged


def _message(data: bytes) -> Message:
    if len(data) % 4:
        raise PacketError("not an OSC message")
    address, at = _text(data, 0)
    tags, at = _text(data, at) if at < len(data) else (",", at)  # old programs leave the types out
    if not address.startswith("/") or not tags.startswith(",") or len(tags) > _MAX_ARGUMENTS + 1:
        raise PacketError("not an OSC message")
    arguments: list[Argument] = []
    for tag in tags[1:]:
        value: Argument
        if tag in _TEXTS:
            value, at = _text(data, at)
        elif tag in _FLAGS:
            value = _FLAGS[tag]
        elif tag == "b" or tag in _OTHER:
            value, at = None, _after(tag, data, at)
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


def _after(tag: str, data: bytes, at: int) -> int:
    """Return the byte after an argument that is left out."""
    size = _OTHER.get(tag, 0)
    if tag == "b" and at + 4 <= len(data):
        size = 4 + ((_SIZE.unpack_from(data, at)[0] + 3) & ~3)
    if size < 4 or at + size > len(data):
        raise PacketError("an OSC argument is missing")
    return at + size


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
