"""Two network namespaces and a wire that delays, loses and reorders packets between them; for root on Linux."""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import os
import select
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from random import Random
from time import perf_counter
from types import TracebackType
from typing import Any

from lab.bench.link import Link

ADDRESSES = ("10.93.0.1", "10.93.0.2")
"""Addresses of the two ends."""
_DEVICE, _MASK = b"wire", "255.255.255.0"
_NEW_NETWORK = 0x40000000
_TUN_FLAGS, _SET_DEVICE = 0x0001 | 0x1000, 0x400454CA
_SET_ADDRESS, _SET_MASK, _SET_FLAGS, _UP_AND_RUNNING = 0x8916, 0x891C, 0x8914, 0x41
_LIBC = ctypes.CDLL(None, use_errno=True)


def may_join() -> bool:
    """Return whether this process may make namespaces and join them."""
    try:
        with Wire(Link()):
            return True
    except OSError:
        return False


class Wire:
    """Two namespaces, and a thread that forwards IP packets between them as `link` says; a context manager.

    While `cut` is set, all packets are dropped.
    """

    def __init__(self, link: Link) -> None:
        self.cut, self._link, self._rng = False, link, Random(0)
        self._ends: list[tuple[int, int]] = []
        self._stack, self._over = ExitStack(), threading.Event()
        self._thread = threading.Thread(target=self._forward, name="wire", daemon=True)

    def __enter__(self) -> Wire:
        with ExitStack() as stack:
            for address in ADDRESSES:
                namespace, device = _in_thread(lambda address=address: _new_end(address))
                stack.callback(os.close, namespace)
                stack.callback(os.close, device)
                self._ends.append((namespace, device))
            self._stack = stack.pop_all()
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        self._stack.close()

    @contextmanager
    def inside(self, end: int) -> Iterator[None]:
        """Let this thread, and those that it starts, make their sockets in the namespace of an end, 0 or 1."""
        with Path("/proc/thread-self/ns/net").open("rb") as outside:
            _check(_LIBC.setns(self._ends[end][0], _NEW_NETWORK))
            try:
                yield
            finally:
                _check(_LIBC.setns(outside.fileno(), _NEW_NETWORK))

    def _forward(self) -> None:
        waiting: list[tuple[float, int, int, bytes]] = []
        first, second = (device for _, device in self._ends)
        across, number = {first: second, second: first}, 0
        while not self._over.is_set():
            due = waiting[0][0] - perf_counter() if waiting else 0.02
            for device in select.select(list(across), [], [], min(max(due, 0.0), 0.02))[0]:
                with suppress(BlockingIOError):
                    packet = os.read(device, 65536)
                    late = self._link.delay + self._rng.uniform(-self._link.jitter, self._link.jitter)
                    if not self.cut and self._rng.random() >= self._link.loss:
                        number += 1
                        heapq.heappush(waiting, (perf_counter() + late, number, across[device], packet))
            while waiting and waiting[0][0] <= perf_counter():
                _, _, device, packet = heapq.heappop(waiting)
                os.write(device, packet)


def _new_end(address: str) -> tuple[int, int]:
    """Move this thread to a new namespace with a device of this address; returns descriptors of both."""
    _check(_LIBC.unshare(_NEW_NETWORK))
    with ExitStack() as stack:
        device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        stack.callback(os.close, device)
        fcntl.ioctl(device, _SET_DEVICE, struct.pack("16sH22x", _DEVICE, _TUN_FLAGS))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            for request, given in ((_SET_ADDRESS, address), (_SET_MASK, _MASK)):
                place = struct.pack("=HH4s8x", socket.AF_INET, 0, socket.inet_aton(given))
                fcntl.ioctl(control, request, struct.pack("16s16s8x", _DEVICE, place))
            fcntl.ioctl(control, _SET_FLAGS, struct.pack("16sH22x", _DEVICE, _UP_AND_RUNNING))
        namespace = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        stack.pop_all()
        return namespace, device


def _in_thread(work: Callable[[], Any]) -> Any:
    """Return the result of `work` in a thread of its own, which takes its namespace with it."""
    results: list[Any] = []

    def run() -> None:
        try:
            results.append(work())
        except OSError as error:
            results.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if isinstance(results[0], OSError):
        raise results[0]
    return results[0]


def _check(status: int) -> None:
    if status != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
