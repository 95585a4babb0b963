"""Faces over a network: delay, loss, an interruption, a day of packets, and malformed packets.

The delay and the interruption are measured in real time, with real sockets and a relay between them that delays packets
by a seeded plan. Loss and the day are simulated in simulated time. Run as `python -m bench.remote`.
"""

from __future__ import annotations

import heapq
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from time import perf_counter

import numpy as np

import facemime
from bench.link import Link
from bench.packets import INTACT, is_possible, packets
from bench.report import Table, finish, parser
from bench.viewer import Viewed, view
from facemime.core.capture import VideoSource
from facemime.core.drive.settings import DriveSettings
from facemime.core.heads.rig import built_in_rig
from facemime.core.live.head_drivers import LiveHead
from facemime.core.live.worker import LiveOptions, LiveWorker
from facemime.core.streams.frames import PacketError
from facemime.core.streams.playout import Playout
from facemime.core.streams.sender import SendSettings, StreamSender
from facemime.core.streams.settings import StreamSettings
from facemime.core.streams.source import StreamSource
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.smoothing import ResultSmoother
from facemime.core.tracking.tracker import FaceTracker

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"
_RATE = 30.0
_DELAY = StreamSettings().delay
LINK = Link(0.02, 0.01)
_SEEDS = 8
_VIEWED = ("vertices", "updates/s", "drawn/s", "kB/s", "loaded, MB", "worst vertex, %", "latency, ms")


class Relay(threading.Thread):
    """Forwards datagrams after delays that differ from packet to packet, as a network does.

    Attributes
    ----------
    port : int
        Port that it listens on.
    cut : bool
        Whether it drops all packets.
    """

    def __init__(self, link: Link, to: tuple[str, int]) -> None:
        super().__init__(daemon=True)
        self.cut, self._link, self._to, self._over = False, link, to, threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port = int(self._socket.getsockname()[1])
        self._rng = Random(0)

    def run(self) -> None:
        """Forward packets until `close`."""
        waiting: list[tuple[float, int, bytes]] = []
        number = 0
        while not self._over.is_set():
            due = waiting[0][0] - perf_counter() if waiting else 0.02
            self._socket.settimeout(min(max(due, 0.0), 0.02) or 1e-4)
            try:
                data = self._socket.recv(65536)
                late = self._link.delay + self._rng.uniform(-self._link.jitter, self._link.jitter)
                if not self.cut and self._rng.random() >= self._link.loss:
                    heapq.heappush(waiting, (perf_counter() + late, number, data))
                    number += 1
            except TimeoutError:
                pass
            while waiting and waiting[0][0] <= perf_counter():
                self._socket.sendto(heapq.heappop(waiting)[2], self._to)

    def close(self) -> None:
        """End the thread."""
        self._over.set()
        self.join()
        self._socket.close()


@dataclass(frozen=True)
class Live:
    """Results of a real stream: seconds from sending to moved vertices, and seconds from the end of an interruption."""

    delays: list[float]
    recovery: float
    waiting: int


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("--seconds", type=float, default=20.0, help="seconds for which the delay is measured (20)")
    command.add_argument("--cut", type=float, default=60.0, help="seconds for which the stream is interrupted (60)")
    command.add_argument("--hours", type=float, default=24.0, help="hours of simulated packets (24)")
    command.add_argument("--packets", type=int, default=100_000, help="damaged packets for each protocol (100,000)")
    arguments = command.parse_args()
    take = tracked()
    live = stream(take, arguments.seconds, arguments.cut)
    ratios = {smoothing: loss_jerk(take, smoothing) for smoothing in (0.0, 1.0)}
    growth, drift = day(take, arguments.hours)
    fuzzed = {name: fuzz(name, arguments.packets) for name in INTACT}
    viewed = view(take, arguments.seconds)
    left = [thread.name for thread in threading.enumerate() if thread.name.startswith("facemime")]
    added = 1e3 * float(np.median(live.delays))
    figures = [
        ("frame to moved vertex, median, ms", added, "40"),
        ("frame to moved vertex, 95th percentile, ms", 1e3 * float(np.percentile(live.delays, 95.0)), ""),
        ("jerk at 10 % loss, default smoothing, relative to no loss", ratios[1.0], "1.5"),
        ("jerk at 10 % loss, no smoothing, relative to no loss", ratios[0.0], "1.5"),
        (f"recovery after an interruption of {arguments.cut:g} s, s", live.recovery, "1"),
        (f"longest queue in {arguments.hours:g} h, frames", growth, ""),
        ("threads left running", len(left), "0"),
        (f"drift of the delay in {arguments.hours:g} h at 100 ppm, ms", 1e3 * drift, ""),
    ]
    rows = [(name, n["packets"], n["tracebacks"], n["accepted"], n["microseconds"]) for name, n in fuzzed.items()]
    tables = [
        Table("Streams", ("quantity", "measured", "limit"), figures),
        Table("Damaged packets", ("protocol", "packets", "tracebacks", "wrongly accepted", "median, µs"), rows),
        Table("Viewer", _VIEWED, [_viewed_row(head) for head in viewed]),
    ]
    numbers = {
        "latency_added_ms": added,
        "loss_jerk_ratio": ratios[1.0],
        "loss_jerk_ratio_unsmoothed": ratios[0.0],
        "cut_recovery_s": live.recovery,
        "waiting_at_most": growth,
        "drift_ms": 1e3 * drift,
        "threads_left": len(left),
        "fuzz": fuzzed,
        "viewer": _worst_of(viewed),
    }
    if arguments.figure is not None:
        draw(arguments.figure, live.delays)
    finish(arguments, tables, numbers)
    return 0


def _viewed_row(head: Viewed) -> tuple[object, ...]:
    kilobytes, megabytes = 1e-3 * head.bytes_per_s, 1e-6 * head.loaded_bytes
    share = 100.0 * head.worst_vertex
    return head.vertices, head.updates_per_s, head.moved_per_s, kilobytes, megabytes, share, head.latency_ms


def _worst_of(viewed: list[Viewed]) -> dict[str, object]:
    """The figures of the viewer: the worst of all heads, and those of each head."""
    if not viewed:
        return {}
    return {
        "updates_per_s": min(head.updates_per_s for head in viewed),
        "bytes_per_s": max(head.bytes_per_s for head in viewed),
        "worst_vertex": max(head.worst_vertex for head in viewed),
        "heads": [vars(head) for head in viewed],
    }


def draw(path: Path, delays: list[float]) -> None:
    """Draw the distribution of the delays."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 2.4), layout="constrained")
    axes.hist(1e3 * np.array(delays), bins=np.arange(0.0, 81.0, 1.0), color="#3a7d6b")
    axes.axvline(40.0, color="#b04030", linewidth=1.0)
    axes.set_xlabel("time from sending a frame to the moved vertices, ms")
    axes.set_ylabel("frames")
    axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def tracked() -> Take:
    """The sample clip, tracked, without the frames in which there is no face."""
    with VideoSource(SAMPLE):
        take = track_video(SAMPLE, FaceTracker.load()).finish()
    return take.part(take.found)


def stream(take: Take, seconds: float, cut: float) -> Live:
    """Loop a take through a relay to a worker that drives the built-in head, with an interruption at the end."""
    source = StreamSource(StreamSettings(port=_free_port()))
    source.read(0.0)
    relay = Relay(LINK, source.address)
    sender = StreamSender(SendSettings(port=relay.port))
    head = LiveHead(built_in_rig(), DriveSettings())
    worker = LiveWorker(source, neutral=calibrate(take), heads=(head,), options=LiveOptions(smoothing=0.0))
    shown: list[tuple[float, float, float]] = []
    waiting = 0
    relay.start()
    worker.start()
    while not worker.model:
        time.sleep(0.05)
    sent, began, number, restored, back = {}, perf_counter(), 0, 0.0, 0.0
    try:
        while not back:
            now = perf_counter() - began
            while number / _RATE <= now:
                sent[number] = perf_counter()
                sender.send(number / _RATE, take.result(number % len(take)), None)
                number += 1
            latest = worker.latest
            if latest is not None and (not shown or latest.number != shown[-1][2]):
                if latest.result.confidence > 0.0:  # it arrived, and was not filled in
                    shown.append((latest.time, latest.driven, latest.number))
                if restored and not back and _is_true(latest.result, latest.time, take, shown[0][0]):
                    back = perf_counter() - restored
            waiting = max(waiting, *(len(face.playout._waiting) for _, face in source._faces()), 0)
            relay.cut = seconds <= now < seconds + cut
            if not restored and now >= seconds + cut:
                restored = perf_counter()
            if restored and perf_counter() - restored > 10.0:
                back = float("inf")
            time.sleep(1e-3)
    finally:
        worker.close()
        sender.close()
        relay.close()
    first = round(min(number for number in sent)) / _RATE
    delays = [at - sent[n] for moment, at, _ in shown if (n := round((moment + first) * _RATE)) in sent]
    steady = [delay for delay in delays if 0.0 < delay < 0.5]
    return Live(steady[int(_RATE) :], back, waiting)


def _is_true(result: TrackResult, moment: float, take: Take, first: float) -> bool:
    """Whether the shown face is the one sent for that time, to a hundredth of the eye distance."""
    number = round((moment - first) * _RATE) % len(take)
    near = [take.shape[(number + off) % len(take)] for off in (-1, 0, 1)]
    return min(float(np.abs(result.shape - shape).max()) for shape in near) < 0.01


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def loss_jerk(take: Take, smoothing: float) -> float:
    """Jerk of the shown faces at 10 % loss, relative to that without loss, over several seeds."""
    lossy = [jerk(take, Link(0.02, 0.01, loss=0.1), smoothing, seed) for seed in range(_SEEDS)]
    return float(np.mean(lossy) / np.mean([jerk(take, LINK, smoothing, seed) for seed in range(_SEEDS)]))


def jerk(take: Take, link: Link, smoothing: float, seed: int) -> float:
    """Root mean square of the third difference of the shown landmarks, at the rate of the stream."""
    sent = [(n / _RATE, (n / _RATE, take.result(n))) for n in range(len(take))]
    arrivals = link.deliver(sent, seed)
    playout, smoother = Playout(_DELAY), ResultSmoother(max(smoothing, 1e-9))
    shown, current, last = [], None, -1.0
    for slot in np.arange(link.delay + link.jitter + _DELAY + 0.005, len(take) / _RATE, 1.0 / _RATE):
        # A display that redraws four times per frame shows the frames that are due at each redraw.
        for now in slot + np.arange(-3, 1) / (4.0 * _RATE):
            while arrivals and arrivals[0][0] <= now:
                at, (moment, result) = arrivals.pop(0)
                playout.push(result, moment, at)
            while (frame := playout.pop(now)) is not None:
                if frame.result.found and frame.time > last:
                    seen = smoother.smooth(frame.result, frame.time) if smoothing else frame.result
                    current, last = seen.shape, frame.time
        if current is not None:
            shown.append(current)
    return float(np.sqrt(np.square(np.diff(np.array(shown), n=3, axis=0)).mean()))


def day(take: Take, hours: float) -> tuple[int, float]:
    """Largest number of waiting frames, and change of the delay in seconds, over hours of a repeated take in packets
    from a drifting clock.
    """
    playout, rng, most, fast = Playout(_DELAY), Random(0), 0, 1.0 + 100e-6
    results = [take.result(int(row)) for row in np.flatnonzero(take.found)]
    delays: dict[int, list[float]] = {}
    for number in range(int(3600.0 * hours * _RATE)):
        moment = number / _RATE
        arrival = moment / fast + 0.02 + rng.uniform(-0.01, 0.01)
        playout.push(results[number % len(results)], moment, arrival)
        most = max(most, len(playout._waiting))
        while (frame := playout.pop(arrival)) is not None:
            if not frame.predicted and (number % 3600) < 600:
                delays.setdefault(number // 108_000, []).append(frame.due - frame.time / fast)
    medians = [float(np.median(some)) for some in delays.values()]
    return most, max(medians) - min(medians)


def fuzz(name: str, count: int) -> dict[str, float]:
    """Decode damaged packets; count all, those that raise anything but a refusal, and those wrongly accepted."""
    rng, decoder = Random(name), INTACT[name][0]()
    tracebacks = wrong = refused = 0
    costs = []
    for number in range(count):
        data = damaged(rng, rng.choice(packets(name)))
        if number % 1000 == 0:
            decoder = INTACT[name][0]()
        began = perf_counter()
        try:
            frames = decoder.decode(data)
        except PacketError:
            refused += 1
            frames = []
        except Exception as error:
            tracebacks += 1
            print(f"{name} {number}: {error!r}", file=sys.stderr)
            frames = []
        costs.append(perf_counter() - began)
        wrong += not all(map(is_possible, frames))
    return {
        "packets": count,
        "refused": refused,
        "tracebacks": tracebacks,
        "accepted": wrong,
        "microseconds": 1e6 * float(np.median(costs)),
    }


def damaged(rng: Random, data: bytes) -> bytes:
    """Return a packet with some bytes changed, removed, repeated or added, or noise."""
    changes: tuple[Callable[[bytearray, int], None], ...] = (
        lambda out, at: out.__setitem__(at, rng.randrange(256)),
        lambda out, at: out.__setitem__(slice(at, at + 4), b"\x7f\xc0\0\0" if rng.random() < 0.5 else b"\0\0\xc0\x7f"),
        lambda out, at: out.__delitem__(slice(at, at + rng.choice((1, 4, 40, 2000)))),
        lambda out, at: out.__setitem__(slice(at, at), rng.randbytes(rng.choice((1, 4, 40)))),
        lambda out, at: out.__setitem__(slice(at, at), out[at : at + 64]),
    )
    if rng.random() < 0.05:
        return rng.randbytes(rng.choice((0, 4, 100, 1500)))
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        if out:
            rng.choice(changes)(out, rng.randrange(len(out)))
    return bytes(out)


if __name__ == "__main__":
    sys.exit(main())
