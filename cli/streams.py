"""The commands `send` and `receive`: faces over the network, without Blender."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING

from ..core.errors import FacemimeError, OutputError, SourceError
from ..core.files import settle
from ..core.heads.appearance import built_in_appearance
from ..core.heads.rig import built_in_rig
from ..core.live.head_drivers import LiveHead
from ..core.live.sources import LiveFrame
from ..core.live.worker import LiveWorker
from ..core.streams.addresses import LOOPBACK, parse_address, reachable
from ..core.streams.live_link import ANGLES
from ..core.streams.pairing import PORT as TLS_PORT
from ..core.streams.pairing import Pairing, parse_pairing
from ..core.streams.security import write_key
from ..core.streams.sender import SENT, VTUBE_STUDIO, SendSettings, StreamSender
from ..core.streams.settings import AXES, OWN, PROTOCOLS, StreamSettings
from ..core.streams.source import StreamSource
from ..core.streams.vertices import VERTICES, VertexSender
from ..core.takes.file import SUFFIX, TakeWriter
from ..core.takes.from_animation import IMAGE_SIZE
from ..core.takes.take import describe
from .performance import LOOK, add_source, live_options, open_source, watch
from .puppet.tracked import growing, unfinished_beside
from .terminal.console import Progress, say, tell
from .terminal.options import Commands, add_command, number
from .terminal.outputs import outputs_of
from .terminal.stopping import STOPPING

if TYPE_CHECKING:
    from ..core.streams.tls_server import TlsSender
    from ..core.streams.vtube_studio_api import VTubeStudioSender

    Sender = StreamSender | VertexSender | TlsSender | VTubeStudioSender

_FLUSH = 1.0
"""Seconds after which what was received is on the disk."""


def add_commands(commands: Commands) -> None:
    """Add the commands to the parser."""
    send = add_command(commands, "send", "track a face, and send it to another computer or program")
    add_source(send)
    where = send.add_mutually_exclusive_group(required=True)
    where.add_argument("--to", metavar="HOST[:PORT]", help="where to, as in 192.168.1.7:39539")
    where.add_argument(
        "--serve",
        metavar="HOST[:PORT]",
        help=f"wait for receivers over TLS at this address of this computer; 0.0.0.0 for all (port {TLS_PORT})",
    )
    send.add_argument(
        "--token", type=Path, metavar="FILE", help="where the permission of VTube Studio is kept (with your settings)"
    )
    send.add_argument("--tls", type=Path, metavar="FOLDER", help="certificate and token for --serve, made if missing")
    send.add_argument(
        "--public", default="", metavar="HOST[:PORT]", help="address by which other networks reach this computer"
    )
    send.add_argument("--protocol", choices=(*SENT, VERTICES, VTUBE_STUDIO), default=OWN, help=f"protocol ({OWN})")
    _add_key(send)
    send.add_argument("--subject", default="Facemime", metavar="NAME", help="name of the face in Unreal (Facemime)")
    send.set_defaults(run=run_send)

    receive = add_command(commands, "receive", "record the faces that another computer, program or phone sends")
    receive.add_argument(
        *("-o", "--output"),
        type=Path,
        action="append",
        metavar="TAKE.facetake",
        help="the take; Ctrl-C ends it. Repeat it to record several senders, each to a take of its own",
    )
    receive.add_argument("--new-key", type=Path, metavar="FILE", help="only make a new shared key, for both sides")
    receive.add_argument("--protocol", choices=tuple(PROTOCOLS), default=OWN, help=f"protocol ({OWN})")
    receive.add_argument(
        "--listen",
        default="",
        metavar="HOST[:PORT]",
        help="address of this computer that is listened on; 0.0.0.0 for all (this computer alone, and the usual port)",
    )
    receive.add_argument(
        "--pairing", default="", metavar="LINE", help="connect over TLS to the sender that shows this pairing line"
    )
    receive.add_argument("--phone", default="", metavar="HOST", help="address of a phone that has to be asked to send")
    _add_key(receive)
    receive.add_argument(
        "--sender",
        action="append",
        default=[],
        metavar="NAME",
        help="address or name of the sender, once for each take (the first that comes, then the next)",
    )
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
    open_output = _open_server(arguments) if arguments.serve else _open_sender(arguments)
    source, neutral = open_source(arguments)
    worker = LiveWorker(source, neutral=neutral, options=options)
    sender = open_output(worker)
    progress = Progress(f"Sending {source.name} to {arguments.to or 'receivers over TLS'}")
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


def _open_sender(arguments: argparse.Namespace) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker send what it tracks, or the built-in head that it drives."""
    if arguments.tls is not None or arguments.public:
        raise FacemimeError("--tls and --public are for --serve. Leave them out, or use --serve instead of --to.")
    if arguments.protocol == VTUBE_STUDIO:
        return _open_vtube_studio(arguments)
    host, port = parse_address(arguments.to)
    settings = SendSettings(arguments.protocol, host, port, arguments.key, arguments.subject)

    def open_output(worker: LiveWorker) -> Sender:
        if settings.protocol == VERTICES:
            vertices = VertexSender(settings.host, settings.port, [built_in_appearance()])
            worker.heads, worker.displays = (LiveHead(built_in_rig()),), (vertices,)
            return vertices
        worker.output = sender = StreamSender(settings)
        return sender

    return open_output


def _open_vtube_studio(arguments: argparse.Namespace) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker send what it tracks to VTube Studio on a computer."""
    from ..core.streams.vtube_studio_api import VTubeStudioSender  # its libraries would delay the other commands

    host, port = parse_address(arguments.to)
    token = arguments.token or user_settings() / "vtube_studio_token"

    def open_output(worker: LiveWorker) -> Sender:
        worker.output = sender = VTubeStudioSender(host, port, token)
        return sender

    return open_output


def user_settings() -> Path:
    """Return the folder of the user's settings."""
    places = (os.environ.get("APPDATA"), os.environ.get("XDG_CONFIG_HOME"))
    return Path(next(filter(None, places), Path.home() / ".config")) / "facemime"


def _open_server(arguments: argparse.Namespace) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker serve what it tracks over TLS, and shows the pairing line."""
    from ..core.streams.tls_server import TlsSender  # its libraries would delay the other commands
    from .certificates import load_identity

    if arguments.tls is None:
        raise FacemimeError("There is no certificate. Add --tls FOLDER; it is made there the first time.")
    if arguments.protocol != OWN or arguments.key is not None:
        raise FacemimeError("Over TLS, Facemime's own protocol is sent without a key. Leave out --protocol and --key.")
    host, port = parse_address(arguments.serve, TLS_PORT)
    identity = load_identity(arguments.tls)

    def open_output(worker: LiveWorker) -> Sender:
        worker.output = sender = TlsSender(host, port, identity.context, identity.token)
        public = parse_address(arguments.public, sender.port) if arguments.public else (reachable(host), sender.port)
        say(Pairing(*public, identity.fingerprint, identity.token).line)
        tell("facemime: paste this line at the other computer. Whoever has it can receive.")
        return sender

    return open_output


def run_receive(arguments: argparse.Namespace) -> int:
    """Run `facemime receive`: record until Ctrl-C, or the time is over; returns the exit status."""
    if arguments.new_key is not None:
        write_key(arguments.new_key)
        tell(f"facemime: {arguments.new_key} is a new key. Copy it to the other computer by a way that you trust.")
        return 0
    if not arguments.output:
        raise OutputError("There is no output. Add -o TAKE.facetake.")
    source = StreamSource(_receiver_settings(arguments), every=True)
    outputs: list[Path] = arguments.output
    unfinished = [unfinished_beside(output) for output in outputs]
    with (
        outputs_of([(output, {SUFFIX}) for output in outputs], {"the key": arguments.key}, *unfinished),
        ExitStack() as stack,
    ):
        paths = [stack.enter_context(growing(path)) for path in unfinished]
        try:
            counts = _record(source, paths, arguments.seconds)
        finally:
            source.close()
        if not any(counts):
            raise FacemimeError(f"Nothing came: {_what_came(source)}. Check the address, the port and the firewall.")
        for path, output, count in zip(paths, outputs, counts, strict=True):
            if count:
                settle(path, output)
            else:
                tell(f"facemime: {output} was not written, as its sender never appeared.")
    return 0


def _receiver_settings(arguments: argparse.Namespace) -> StreamSettings:
    host, port = parse_address(arguments.listen or LOOPBACK)
    pairing = parse_pairing(arguments.pairing) if arguments.pairing else None
    flip = tuple(filter(None, (axis.strip() for axis in arguments.flip.split(","))))
    if unknown := set(flip) - set(AXES):
        raise FacemimeError(f"{', '.join(sorted(unknown))} cannot be flipped. Use pitch, yaw and roll.")
    missing = len(arguments.output) - len(arguments.sender)
    if missing < 0:
        raise FacemimeError("There are more senders than takes. Add another -o TAKE.facetake.")
    return StreamSettings(
        *(arguments.protocol, host, port, arguments.phone, arguments.key, arguments.delay),
        angles=arguments.angles,
        flip=flip,
        senders=(*arguments.sender, *[""] * missing),
        pairing=pairing,
    )


def _record(source: StreamSource, paths: Sequence[Path], seconds: float | None) -> list[int]:
    """Record what comes into a take for each sender; returns their numbers of frames."""
    progress = Progress(f"Receiving {source.name}")
    end = monotonic() + (seconds if seconds is not None else float("inf"))
    writers: dict[int, TakeWriter] = {}
    first, last, told = 0.0, monotonic(), ""
    with STOPPING.noting():
        while not STOPPING.heard and monotonic() < end:
            frame, told = _read(source, told, begun=bool(writers))
            if frame is not None and not frame.filled and frame.result is not None:
                number = frame.heads[0] if frame.heads else 0
                first = first if writers else frame.time
                if number not in writers:
                    writers[number] = TakeWriter(paths[number], _description(source, frame))
                if frame.time >= first:
                    writers[number].append(frame.time - first, frame.result)
            if monotonic() - last > _FLUSH:
                for writer in writers.values():
                    writer.flush()
                last = monotonic()
            progress.update(sum(map(len, writers.values())))
        for writer in writers.values():
            writer.close()
    progress.finish(_what_came(source))
    return [len(writers[number]) if number in writers else 0 for number in range(len(paths))]


def _read(source: StreamSource, told: str, *, begun: bool) -> tuple[LiveFrame | None, str]:
    """Read a frame, and say why none comes if that was not said last; returns what was said."""
    frame = None
    try:
        frame = source.read(LOOK)
        message = source.message
    except SourceError as error:
        if not begun:
            raise
        message = str(error)  # what came before is recorded, and the sender may come back
        sleep(LOOK)
    if message and message != told:
        tell(f"facemime: {message}")
    return frame, message


def _description(source: StreamSource, frame: LiveFrame) -> dict[str, object]:
    info = describe(source.name, 60.0, IMAGE_SIZE, "stream", source.clock) | {"sender": frame.sender}
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
