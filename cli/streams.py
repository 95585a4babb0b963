"""The commands `send` and `receive`: faces over the network, without Blender."""

from __future__ import annotations

import argparse
from pathlib import Path
from time import monotonic

from ..core.errors import FacemimeError, OutputError
from ..core.files import settle
from ..core.heads.appearance import built_in_appearance
from ..core.heads.rig import built_in_rig
from ..core.live.head_drivers import LiveHead
from ..core.live.sources import LiveFrame
from ..core.live.worker import LiveWorker
from ..core.streams.live_link import ANGLES
from ..core.streams.security import write_key
from ..core.streams.sender import SENT, SendSettings, StreamSender
from ..core.streams.settings import AXES, LOOPBACK, OWN, PROTOCOLS, StreamSettings, parse_address
from ..core.streams.source import StreamSource
from ..core.streams.vertices import VERTICES, VertexSender
from ..core.takes.file import SUFFIX, TakeWriter
from ..core.takes.from_animation import IMAGE_SIZE
from ..core.takes.take import describe
from .performance import LOOK, add_source, live_options, open_source, watch
from .puppet.tracked import growing, unfinished_beside
from .terminal.console import Progress, tell
from .terminal.options import Commands, add_command, number
from .terminal.outputs import outputs_of
from .terminal.stopping import STOPPING

_FLUSH = 1.0
"""Seconds after which what was received is on the disk."""


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    send = add_command(commands, "send", "track a face, and send it to another computer or program")
    add_source(send)
    send.add_argument("--to", required=True, metavar="HOST[:PORT]", help="where to, as in 192.168.1.7:39539")
    send.add_argument("--protocol", choices=(*SENT, VERTICES), default=OWN, help=f"protocol ({OWN})")
    _add_key(send)
    send.add_argument("--subject", default="Facemime", metavar="NAME", help="name of the face in Unreal (Facemime)")
    send.set_defaults(run=run_send)

    receive = add_command(commands, "receive", "record the faces that another computer, program or phone sends")
    receive.add_argument("-o", "--output", type=Path, metavar="TAKE.facetake", help="the take; Ctrl-C ends it")
    receive.add_argument("--new-key", type=Path, metavar="FILE", help="only make a new shared key, for both sides")
    receive.add_argument("--protocol", choices=tuple(PROTOCOLS), default=OWN, help=f"protocol ({OWN})")
    receive.add_argument(
        "--listen",
        default="",
        metavar="HOST[:PORT]",
        help="address of this computer that is listened on; 0.0.0.0 for all (this computer alone, and the usual port)",
    )
    receive.add_argument("--phone", default="", metavar="HOST", help="address of a phone that has to be asked to send")
    _add_key(receive)
    receive.add_argument("--sender", default="", metavar="NAME", help="address or name of the sender (the first)")
    receive.add_argument("--delay", type=number, default=0.02, metavar="S", help="delay that evens out jitter (0.02)")
    receive.add_argument("--angles", choices=tuple(ANGLES), default="radians", help="of Live Link Face (radians)")
    receive.add_argument("--flip", default="", metavar="AXIS,...", help="rotations to reverse: pitch, yaw, roll (none)")
    receive.add_argument("--seconds", type=number, metavar="S", help="stop after this time (Ctrl-C)")
    receive.set_defaults(run=run_receive)


def _add_key(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--key", type=Path, metavar="FILE", help="shared key, for Facemime's own protocol")


def run_send(arguments: argparse.Namespace) -> int:
    """Run `facemime send`: track and send until the end, Ctrl-C, or the time is over; returns the exit status."""
    options = live_options(arguments)
    host, port = parse_address(arguments.to)
    settings = SendSettings(arguments.protocol, host, port, arguments.key, arguments.subject)
    source, neutral = open_source(arguments)
    worker = LiveWorker(source, neutral=neutral, options=options)
    sender = _send_from(worker, settings)
    progress = Progress(f"Sending {source.name} to {arguments.to}")
    with STOPPING.noting():
        worker.start()
        try:
            watch(worker, lambda: (sender.sent, sender.message), progress, arguments.seconds)
        finally:
            worker.close()
            sender.close()
    if worker.error is not None:
        raise worker.error
    progress.finish(sender.message or ("" if sender.sent else "nothing was sent, as nobody answered"))
    return 0


def _send_from(worker: LiveWorker, settings: SendSettings) -> StreamSender | VertexSender:
    """Make a worker send what it tracks, or the built-in head that it drives."""
    if settings.protocol == VERTICES:
        vertices = VertexSender(settings.host, settings.port, [built_in_appearance()])
        worker.heads, worker.displays = (LiveHead(built_in_rig()),), (vertices,)
        return vertices
    worker.output = sender = StreamSender(settings)
    return sender


def run_receive(arguments: argparse.Namespace) -> int:
    """Run `facemime receive`: record until Ctrl-C, or the time is over; returns the exit status."""
    if arguments.new_key is not None:
        write_key(arguments.new_key)
        tell(f"facemime: {arguments.new_key} is a new key. Copy it to the other computer by a way that you trust.")
        return 0
    if arguments.output is None:
        raise OutputError("There is no output. Add -o TAKE.facetake.")
    host, port = parse_address(arguments.listen or LOOPBACK)
    flip = tuple(filter(None, (axis.strip() for axis in arguments.flip.split(","))))
    if unknown := set(flip) - set(AXES):
        raise FacemimeError(f"{', '.join(sorted(unknown))} cannot be flipped. Use pitch, yaw and roll.")
    source = StreamSource(
        StreamSettings(
            *(arguments.protocol, host, port, arguments.phone, arguments.key, arguments.delay, arguments.sender),
            angles=arguments.angles,
            flip=flip,
        ),
        every=True,
    )
    unfinished = unfinished_beside(arguments.output)
    with (
        outputs_of(((arguments.output, {SUFFIX}),), {"the key": arguments.key}, unfinished),
        growing(unfinished) as path,
    ):
        try:
            count = _record(source, path, arguments.seconds)
        finally:
            source.close()
        if not count:
            raise FacemimeError(f"Nothing came: {_what_came(source)}. Check the address, the port and the firewall.")
        settle(path, arguments.output)
    return 0


def _record(source: StreamSource, path: Path, seconds: float | None) -> int:
    """Record what comes into a take; returns the number of frames."""
    progress = Progress(f"Receiving {source.name}")
    end = monotonic() + (seconds if seconds is not None else float("inf"))
    writer: TakeWriter | None = None
    count, first, last = 0, 0.0, monotonic()
    with STOPPING.noting():
        while not STOPPING.heard and monotonic() < end:
            frame = source.read(LOOK)
            if frame is not None and not frame.filled and frame.result is not None:
                writer = writer or TakeWriter(path, _description(source, frame))
                first = first if count else frame.time
                writer.append(frame.time - first, frame.result)
                count += 1
            if writer is not None and monotonic() - last > _FLUSH:
                writer.flush()
                last = monotonic()
            progress.update(count)
        if writer is not None:
            writer.close()
    progress.finish(_what_came(source))
    return count


def _description(source: StreamSource, frame: LiveFrame) -> dict[str, object]:
    info = describe(source.name, 60.0, IMAGE_SIZE, "stream", source.clock)
    if frame.neutral is not None:
        info |= {"measured": True, "calibration": frame.neutral.to_dict()}
    return info


def _what_came(source: StreamSource) -> str:
    counts = source.counts
    parts = {
        "packets": counts.received,
        "not of this protocol": counts.malformed,
        "refused": counts.refused,
        "late": counts.late,
        "doubled": counts.doubled,
        "frames lost": counts.lost,
    }
    return ", ".join(f"{count} {name}" for name, count in parts.items() if count or name == "packets")
