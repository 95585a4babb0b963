"""Faces over a network: delay, loss, an interruption, a day of packets, and malformed packets.

The delay and the interruption are measured in real time, with real sockets in two network namespaces and a wire between
them that delays and loses packets, which needs root. The jerk and the day are simulated in simulated time. Run as
`python -m lab.bench.remote`.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

import facemime
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.files.capture import VideoSource
from facemime.core.heads.rig import built_in_head
from facemime.core.puppet.outputs import LiveHead
from facemime.core.puppet.worker import LiveOptions, LiveWorker
from facemime.core.streams.playout import Playout
from facemime.core.streams.protocols.frames import PacketError
from facemime.core.streams.sender import StreamSender
from facemime.core.streams.source import StreamSource
from facemime.core.streams.stream_settings import SendSettings, StreamSettings
from facemime.core.streams.transport import datagram
from facemime.core.streams.transport.security import load_identity, write_key
from facemime.core.streams.transport.tls_server import TlsSender
from facemime.core.takes.from_video import track_video
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from facemime.core.tracking.result import TrackResult
from facemime.core.tracking.smoothing import ResultSmoother
from facemime.core.tracking.tracker import FaceTracker
from lab.bench.link import Link
from lab.bench.namespaces import ADDRESSES, Wire, may_join
from lab.bench.packets import INTACT, is_possible, packets
from lab.bench.report import Table, finish, parser
from lab.bench.viewer import Viewed, view

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"
_RATE = 30.0
_DELAY = StreamSettings().delay
LINK = Link(0.02, 0.01)
_SEEDS, _WARM_UP = 8, 3.0
"""Number of simulated streams, and seconds of a real one before it is measured."""
_MARK = 4
"""Element of a pose that bears the number of the frame."""
_LOSSES = {"signed packets": 0.1, "TLS": 0.02}
"""Shares of lost packets at which streams are measured, too; TCP repeats lost packets, which delays all others."""
_STREAMED = ("stream", "lost, %", "median, ms", "95th percentile, ms", "shown, %", "recovery, s")
_VIEWED = ("vertices", "updates/s", "drawn/s", "kB/s", "loaded, MB", "worst vertex, %", "latency, ms")


@dataclass(frozen=True)
class Live:
    """Results of a real stream.

    Attributes
    ----------
    delays : list of float
        Seconds from sending a frame to the moved vertices.
    shown : float
        Share of frames that were shown.
    recovery : float
        Seconds from the end of an interruption to the first new frame.
    """

    delays: list[float]
    shown: float
    recovery: float

    def row(self, name: str, loss: float) -> tuple[object, ...]:
        """Row of the table of streams."""
        median, most = (1e3 * float(np.percentile(self.delays, share)) for share in (50.0, 95.0))
        recovery = "" if np.isnan(self.recovery) else self.recovery
        return name, 100.0 * loss, median, most, 100.0 * self.shown, recovery


def main() -> int:
    """Run the benchmark; returns the exit status."""
    command = parser(__doc__.splitlines()[0])
    command.add_argument("--seconds", type=float, default=20.0, help="seconds for which the delay is measured (20)")
    command.add_argument("--cut", type=float, default=60.0, help="seconds for which the stream is interrupted (60)")
    command.add_argument("--hours", type=float, default=24.0, help="hours of simulated packets (24)")
    command.add_argument("--packets", type=int, default=100_000, help="damaged packets for each protocol (100,000)")
    arguments = command.parse_args()
    if not may_join():
        print("The benchmark makes two network namespaces. Run it as root, on Linux.", file=sys.stderr)
        return 1
    take = tracked()
    streams = {
        (name, loss): stream(take, arguments.seconds, 0.0 if loss else arguments.cut, loss, opened)
        for name, opened in (("signed packets", signed), ("TLS", over_tls))
        for loss in (0.0, _LOSSES[name])
    }
    live = streams["signed packets", 0.0]
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
        Table("Between two rooms", _STREAMED, [each.row(*key) for key, each in streams.items()]),
        Table("Damaged packets", ("protocol", "packets", "tracebacks", "wrongly accepted", "median, µs"), rows),
        Table("Viewer", _VIEWED, [_viewed_row(head) for head in viewed]),
    ]
    numbers = {
        "latency_added_ms": added,
        "loss_jerk_ratio": ratios[1.0],
        "loss_jerk_ratio_unsmoothed": ratios[0.0],
        "cut_recovery_s": max(each.recovery for (_, loss), each in streams.items() if not loss),
        "streams": [dict(zip(_STREAMED, each.row(*key), strict=True)) for key, each in streams.items()],
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
        take = track_video(SAMPLE, FaceTracker.load())
    return take.part(take.found)


def signed(wire: Wire, folder: Path) -> tuple[StreamSender, StreamSettings]:
    """A sender of signed packets in the first room, and the settings of a receiver in the second."""
    write_key(folder / "key")
    settings = StreamSettings(host=ADDRESSES[1], port=datagram.PORT, key=folder / "key")
    with wire.inside(0):
        return StreamSender(SendSettings(host=settings.host, port=settings.port, key=settings.key)), settings


def over_tls(wire: Wire, folder: Path) -> tuple[TlsSender, StreamSettings]:
    """A server in the first room, and the settings of a receiver in the second that is paired with it."""
    identity = load_identity(folder)
    with wire.inside(0):
        sender = TlsSender(ADDRESSES[0], 0, identity.context, identity.token)
    pairing = identity.pairing(ADDRESSES[0], sender.port)
    return sender, StreamSettings(pairing=pairing)


def stream(
    take: Take,
    seconds: float,
    cut: float,
    loss: float,
    opened: Callable[[Wire, Path], tuple[StreamSender | TlsSender, StreamSettings]],
) -> Live:
    """Loop a take from one room to a worker in the other that drives the built-in head; it is interrupted at the end.

    It is measured for `seconds`, after which no packets come for `cut` seconds; `loss` is the share of packets that are
    lost. `opened` makes the sender and the settings of the receiver. The recovery is NaN without an interruption.
    """
    with Wire(replace(LINK, loss=loss)) as wire, TemporaryDirectory() as folder:
        sender, settings = opened(wire, Path(folder))
        head = LiveHead(built_in_head(), DriveSettings())
        with wire.inside(1):
            source = StreamSource(settings)
            source.read(0.0)
            worker = LiveWorker(source, neutral=calibrate(take), heads=(head,), options=LiveOptions(smoothing=0.0))
            worker.start()
        while not worker.model:
            time.sleep(0.05)
        sent: dict[int, float] = {}
        shown: dict[int, float] = {}
        began, restored, back = perf_counter(), 0.0, np.nan
        try:
            while (now := perf_counter() - began) < _WARM_UP + seconds + cut + 10.0 and np.isnan(back):
                while len(sent) / _RATE <= now:
                    number = len(sent)
                    sent[number] = perf_counter()
                    sender.send(number / _RATE, _numbered(take.result(number % len(take)), number), None)
                frame = worker.latest
                if frame is not None and frame.result.confidence > 0.0:  # it arrived, and was not filled in
                    number = round(float(frame.result.pose[_MARK]))
                    shown.setdefault(number, frame.driven)
                    if restored and sent[number] > restored and _is_true(frame.result, take, number):
                        back = perf_counter() - restored
                wire.cut = _WARM_UP + seconds <= now < _WARM_UP + seconds + cut
                if now >= _WARM_UP + seconds + cut:
                    if not cut:
                        break
                    restored = restored or perf_counter()
                time.sleep(1e-3)
            else:
                back = back if np.isfinite(back) else float("inf")
        finally:
            worker.close()
            sender.close()
    steady = range(int(_RATE * _WARM_UP), int(_RATE * (_WARM_UP + seconds - 1.0)))
    delays = [shown[number] - sent[number] for number in steady if number in shown]
    return Live(delays, len(delays) / len(steady), back)


def _numbered(result: TrackResult, number: int) -> TrackResult:
    """Return a result that bears its number where the position of the face in the image was."""
    pose = result.pose.copy()
    pose[_MARK] = number
    return replace(result, pose=pose)


def _is_true(result: TrackResult, take: Take, number: int) -> bool:
    """Whether the shown face is the one sent as that frame, to a hundredth of the eye distance."""
    return float(np.abs(result.shape - take.shape[number % len(take)]).max()) < 0.01


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
