"""The commands `send` and `receive`: faces over the network, without Blender."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from time import monotonic

from ..core.errors import FacemimeError, OutputError
from ..core.files import settle
from ..core.live.camera import Camera, CameraSettings, list_cameras, parse_device
from ..core.live.sources import LiveFrame, LiveSource, TakePlayer, VideoPlayer
from ..core.live.worker import LiveOptions, LiveWorker
from ..core.streams.live_link import ANGLES
from ..core.streams.security import write_key
from ..core.streams.sender import SENT, SendSettings, StreamSender
from ..core.streams.settings import AXES, LOOPBACK, OWN, PROTOCOLS, StreamSettings, parse_address
from ..core.streams.source import StreamSource
from ..core.takes.file import SUFFIX, TakeWriter
from ..core.takes.from_animation import IMAGE_SIZE
from ..core.takes.neutral import Neutral
from ..core.takes.take import describe
from .puppet.tracked import growing, unfinished_beside
from .terminal.console import Progress, tell
from .terminal.options import Commands, add_command, add_face_option, face_of, number
from .terminal.outputs import outputs_of
from .terminal.stopping import STOPPING
from .terminal.takes import load_with_warnings

_LOOK = 0.1
"""Seconds between two looks at what the worker does."""
_FLUSH = 1.0
"""Seconds after which what was received is on the disk."""


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    send = add_command(commands, "send", "track a face, and send it to another computer or program")
    source = send.add_mutually_exclusive_group(required=True)
    source.add_argument("--camera", metavar="N|NAME", help="a camera, by number or name")
    source.add_argument("--video", type=Path, metavar="VIDEO|TAKE", help="a video or a take, played in real time")
    send.add_argument("--to", required=True, metavar="HOST[:PORT]", help="where to, as in 192.168.1.7:39539")
    send.add_argument("--protocol", choices=tuple(SENT), default=OWN, help=f"protocol ({OWN})")
    _add_key(send)
    send.add_argument("--subject", default="Facemime", metavar="NAME", help="name of the face in Unreal (Facemime)")
    send.add_argument("--loop", action="store_true", help="start the video again at its end")
    send.add_argument(
        "--smoothing", type=number, default=1.0, metavar="AMOUNT", help="jitter smoothing; 0 for none (1)"
    )
    send.add_argument("--seconds", type=number, metavar="S", help="stop after this time (Ctrl-C, or the video's end)")
    add_face_option(send)
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
    if arguments.smoothing < 0.0:
        raise FacemimeError(f"--smoothing cannot be {arguments.smoothing:g}. Use 0 or more.")
    face = face_of(arguments.face)
    host, port = parse_address(arguments.to)
    settings = SendSettings(arguments.protocol, host, port, arguments.key, arguments.subject)
    source, neutral = _source(arguments)
    options = LiveOptions(smoothing=arguments.smoothing, face=face)
    sender = StreamSender(settings)
    worker = LiveWorker(source, neutral=neutral, options=options, output=sender)
    progress = Progress(f"Sending {source.name} to {arguments.to}")
    with STOPPING.noting():
        worker.start()
        try:
            _watch(worker, sender, progress, arguments.seconds)
        finally:
            worker.close()
    if worker.error is not None:
        raise worker.error
    progress.finish(sender.message or ("" if sender.sent else "nothing was sent, as nobody answered"))
    return 0


def _watch(worker: LiveWorker, sender: StreamSender, progress: Progress, seconds: float | None) -> None:
    """Show progress until the worker ends, a signal comes, or the time is over."""
    end, told = monotonic() + (seconds if seconds is not None else float("inf")), ""
    while worker.running and not STOPPING.heard and monotonic() < end:
        time.sleep(_LOOK)
        progress.update(sender.sent)
        if (message := worker.message or sender.message) != told:
            told = message
            if message:
                tell(f"facemime: {message}")
    progress.update(sender.sent)


def _source(arguments: argparse.Namespace) -> tuple[LiveSource, Neutral | None]:
    if arguments.camera is not None:
        return Camera(CameraSettings(parse_device(arguments.camera, list_cameras()))), None
    if arguments.video.suffix.lower() == SUFFIX:
        take = load_with_warnings(arguments.video)
        stored = take.info.get("calibration")
        neutral = None if stored is None else Neutral.from_dict(stored)
        return TakePlayer(take, arguments.video.name, loop=arguments.loop), neutral
    return VideoPlayer(arguments.video, loop=arguments.loop), None


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
            frame = source.read(_LOOK)
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
