"""A relay with many viewers on one computer: what they receive, how late, and what the sender takes for it.

The viewers are simulated: they connect and subscribe as the page does, and read the frames, but draw nothing. They
share the processor with the sender and the relay.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import selectors
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, sleep
from urllib.parse import urlsplit

import numpy as np

from facemime.core.drive.driver import HeadDriver
from facemime.core.heads.appearance import built_in_appearance
from facemime.core.heads.rig import built_in_head
from facemime.core.takes.measured import coefficient_face
from facemime.core.viewer.messages import PING, NatsReader, connecting, subscribing
from facemime.core.viewer.relay import RelaySender
from facemime.core.viewer.server import ViewerServer
from facemime.core.viewer.site import SUBJECT, VIEWER, Relay, Site
from facemime.core.viewer.viewer_settings import ViewerSettings
from lab.bench.report import Table, finish, parser

_OWN, _RELAY = "the viewer's own server", "relay"
_RATE, _WARM_UP, _LATE = 30.0, 1.0, 10.0
"""Frames per second; seconds that are not measured, and seconds for the last frame to arrive."""
_HEADER = struct.Struct("<BBHId")
_COLUMNS = ("frames by", "viewers", "sender, % of a core", "relay, % of a core", "received, %", "newest frame, viewers")
_DELAYS = ("median, ms", "95th percentile, ms")


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("--seconds", type=float, default=20.0, help="seconds for which each is measured (20)")
    command.add_argument("--viewers", type=int, default=1000, help="largest number of viewers (1,000)")
    command.add_argument("--send", nargs=2, metavar=("KIND", "PLACE"), help=argparse.SUPPRESS)
    arguments = command.parse_args()
    if arguments.send is not None:
        return send(*arguments.send, arguments.seconds)
    server = shutil.which("nats-server", path=f"{os.environ['PATH']}{os.pathsep}/usr/sbin")
    if server is None:
        print("nats-server was not found. Run make programs.", file=sys.stderr)
        return 1
    measured = [
        measure(server, kind, count, arguments.seconds)
        for kind, count in ((_OWN, 1), (_OWN, 16), (_RELAY, 0), (_RELAY, 1), (_RELAY, 16), (_RELAY, arguments.viewers))
    ]
    rows = [tuple(one.values()) for one in measured]
    finish(arguments, [Table("Relay", (*_COLUMNS, *_DELAYS), rows)], {"relay": measured})
    return 0


@dataclass
class Viewer:
    """A simulated viewer.

    Attributes
    ----------
    socket : socket.socket
        Its connection.
    reader : NatsReader or None
        Reads NATS' protocol; None if each message is a frame.
    numbers : list of int
        Numbers of the frames that it received.
    delays : list of float
        Seconds from sending to receiving each of them.
    """

    socket: socket.socket
    reader: NatsReader | None
    numbers: list[int] = field(default_factory=list)
    delays: list[float] = field(default_factory=list)
    data: bytes = b""

    def receive(self) -> None:
        """Read what has arrived."""
        self.data += self.socket.recv(65536)
        now = perf_counter()
        while (message := self._message()) is not None:
            frames = [message]
            if self.reader is not None:
                frames = [operation.payload for operation in self.reader.feed(message) if operation.verb == "MSG"]
            for frame in frames:
                if len(frame) > _HEADER.size and frame[0] == 1:
                    _, _, _, number, sent = _HEADER.unpack_from(frame)
                    self.numbers.append(number)
                    self.delays.append(now - sent)

    def _message(self) -> bytes | None:
        """Return the next message of the WebSocket, which a server does not mask; None if it is not complete."""
        data = self.data
        if len(data) < 4:
            return None
        size, start = (data[1], 2) if data[1] < 126 else (int.from_bytes(data[2:4], "big"), 4)
        if len(data) < start + size:
            return None
        self.data = data[start + size :]
        return data[start : start + size]


def joined(url: str, reader: NatsReader | None, greeting: bytes) -> Viewer:
    """Connect a viewer to a WebSocket, and send its greeting."""
    parts = urlsplit(url)
    connection = socket.create_connection((parts.hostname, parts.port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.sendall(
        f"GET {parts.path or '/'} HTTP/1.1\r\nHost: {parts.netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
    )
    answer = b""
    while b"\r\n\r\n" not in answer:
        answer += connection.recv(4096)
    head, _, rest = answer.partition(b"\r\n\r\n")
    assert b" 101 " in head.splitlines()[0], head
    if greeting:
        connection.sendall(bytes([0x82, 0x80 | 126]) + len(greeting).to_bytes(2, "big") + bytes(4) + greeting)
    return Viewer(connection, reader, data=rest)


def measure(server: str, kind: str, count: int, seconds: float) -> dict[str, object]:
    """Measure a sender with a number of viewers."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        site = Site(folder, Relay(f"ws://127.0.0.1:{_free_port()}"))
        relay = None
        if kind == _RELAY:
            line = [server, "--config", str(site.configuration)]
            relay = stack.enter_context(subprocess.Popen(line, stderr=subprocess.DEVNULL))
            stack.callback(relay.terminate)
        line = [sys.executable, "-m", "lab.bench.relay", "--seconds", str(seconds), "--send", kind]
        place = site.relay.url if kind == _RELAY else ""
        sender = stack.enter_context(
            subprocess.Popen([*line, f"{folder}|{place}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        )
        address = sender.stdout.readline().strip()
        greeting = connecting(VIEWER, site.page.name) + subscribing(SUBJECT) + PING
        viewers = [
            joined(address, *((NatsReader(), greeting) if kind == _RELAY else (None, b""))) for _ in range(count)
        ]
        sleep(_WARM_UP)
        before = 0.0 if relay is None else _seconds_of(relay.pid)
        sender.stdin.write("go\n")
        sender.stdin.flush()
        watch(viewers, sender)
        taken = 0.0 if relay is None else _seconds_of(relay.pid) - before
        told = json.loads(sender.stdout.readline())
        watch(viewers, None, told["last"])
        for viewer in viewers:
            viewer.socket.close()
    delays = 1e3 * np.concatenate([viewer.delays for viewer in viewers]) if count else np.zeros(1)
    new = range(told["last"] - told["sent"] + 1, told["last"] + 1)
    received = sum(number in new for viewer in viewers for number in viewer.numbers) / max(count * told["sent"], 1)
    newest = sum(viewer.numbers[-1:] == [told["last"]] for viewer in viewers)
    values = (
        *(kind, count, 100.0 * told["cpu"] / seconds, 100.0 * taken / seconds if relay is not None else ""),
        *((100.0 * received, newest, *np.percentile(delays, (50.0, 95.0)).tolist()) if count else ("", "", "", "")),
    )
    return dict(zip((*_COLUMNS, *_DELAYS), values, strict=True))


def watch(viewers: list[Viewer], sender: subprocess.Popen | None, last: int = -1) -> None:
    """Read for all viewers until the sender has something to say, or else until all have the last frame."""
    with selectors.DefaultSelector() as selector:
        for viewer in viewers:
            selector.register(viewer.socket, selectors.EVENT_READ, viewer)
        if sender is not None:
            selector.register(sender.stdout, selectors.EVENT_READ, None)
        end = perf_counter() + _LATE
        while sender is not None or any(viewer.numbers[-1:] != [last] for viewer in viewers):
            for key, _ in selector.select(0.1):
                if key.data is None:
                    return
                key.data.receive()
            if sender is None and perf_counter() > end:
                return


def send(kind: str, place: str, seconds: float) -> int:
    """Send frames after a line on the standard input, and print what this took."""
    folder, _, url = place.partition("|")
    driver, looks = HeadDriver(built_in_head(lashes=True), coefficient_face().neutral), built_in_appearance()
    rng = np.random.default_rng(1)
    results = [coefficient_face().result(rng.uniform(0.0, 0.8, 52), np.zeros(3), None) for _ in range(30)]
    frames = [driver.frame(result) for result in results]
    opened = (
        RelaySender(Site(Path(folder), Relay(url)), [looks]) if url else ViewerServer(ViewerSettings(port=0), [looks])
    )
    with opened as sender:
        address = url or f"{sender.address.replace('http', 'ws')}stream"
        while not sender.sent:  # prepares the model
            sender.show(perf_counter(), [driver], frames[:1])
            sleep(0.1)
        print(address, flush=True)
        sys.stdin.readline()
        began, before, first = perf_counter(), _seconds(), sender.sent
        for number in range(round(seconds * _RATE)):
            sleep(max(began + number / _RATE - perf_counter(), 0.0))
            sender.show(perf_counter(), [driver], [frames[number % len(frames)]])
        sleep(0.2)
        last = sender.shown if url else sender.sent
        print(json.dumps({"cpu": _seconds() - before, "sent": sender.sent - first, "last": last}), flush=True)
        sys.stdin.readline()
    return 0


def _seconds() -> float:
    """Return the seconds of processor time of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _seconds_of(process: int) -> float:
    """Return the seconds of processor time of another process."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


if __name__ == "__main__":
    sys.exit(main())
