"""The command `receive`: faces from the network as takes, without Blender."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from time import monotonic, sleep

from ..core.errors import FacemimeError, OutputError, SourceError
from ..core.files.writing import settle
from ..core.puppet.sources import LiveFrame
from ..core.streams.diagnosis import table
from ..core.streams.source import StreamSource
from ..core.streams.stream_settings import AXES, OWN, PROTOCOLS, StreamSettings
from ..core.streams.transport.addresses import LOOPBACK, parse_address, parse_pairing
from ..core.streams.transport.security import write_key
from ..core.takes.file import SUFFIX, TakeWriter
from ..core.takes.measured import IMAGE_SIZE
from ..core.takes.take import describe
from .console import Progress, Screen, for_terminal, tell
from .job_files import growing, outputs_of, unfinished_beside
from .options import Commands, Options, add_command, add_key_option, add_settings, filled, number
from .performance import LOOK
from .stopping import STOPPING

_FLUSH = 1.0
"""Seconds after which what was received is on the disk."""


def add_commands(commands: Commands) -> None:
    """Add the command to the parser."""
    receive = add_command(commands, "receive", "record the faces that another computer, program or phone sends")
    receive.add_argument(
        *("-o", "--output"),
        type=Path,
        action="append",
        default=[],
        metavar="TAKE.facetake",
        help="the take; Ctrl-C ends it. Repeat the option to record several senders, one take for each",
    )
    receive.add_argument("--new-key", type=Path, metavar="FILE", help="only write a new shared key, for both computers")
    receive.add_argument("--protocol", choices=tuple(PROTOCOLS), default=OWN, help=f"protocol ({OWN})")
    receive.add_argument(
        "--listen",
        default="",
        metavar="HOST[:PORT]",
        help="address of this computer to listen on; 0.0.0.0 for all (this computer alone, and the usual port)",
    )
    receive.add_argument(
        "--pairing", default="", metavar="LINE", help="connect over TLS to the sender that printed this pairing line"
    )
    receive.add_argument(
        "--phone", default="", metavar="HOST", help="address of the phone, for apps that have to be asked to send"
    )
    add_key_option(receive)
    receive.add_argument(
        "--sender",
        action="append",
        default=[],
        metavar="NAME",
        help="address or name of the sender, once for each take (the first that comes, then the next)",
    )
    add_settings(receive, StreamSettings)
    receive.add_argument("--flip", default="", metavar="AXIS,...", help="rotations to reverse: pitch, yaw, roll (none)")
    receive.add_argument(
        "--watch", action="store_true", help="show the values that arrive, for setting up a phone; -o may be left out"
    )
    receive.add_argument("--seconds", type=number, metavar="S", help="stop after this time (Ctrl-C)")
    receive.set_defaults(run=_run_receive)


def _run_receive(options: Options) -> int:
    """Run `facemime receive`: record, or make a shared key; returns the exit status."""
    if options["new_key"] is not None:
        write_key(options["new_key"])
        tell(
            f"facemime: {options['new_key']} is a new key. Copy it to the other computer over a channel that you trust."
        )
        return 0
    return _record_streams(options, _settings(options))


def _settings(options: Options) -> StreamSettings:
    """Return where the streams come from, with a sender for each take."""
    outputs, senders = options["output"], options["sender"]
    if not outputs and not options["watch"]:
        raise OutputError("There is no output. Add -o TAKE.facetake, or --watch to only see the values.")
    if len(senders) > max(len(outputs), 1):
        raise FacemimeError("There are more senders than takes. Add another -o TAKE.facetake.")
    flip = tuple(filter(None, (axis.strip() for axis in options["flip"].split(","))))
    if unknown := set(flip) - set(AXES):
        raise FacemimeError("{unknown} cannot be flipped. Use pitch, yaw and roll.", unknown=", ".join(sorted(unknown)))
    host, port = parse_address(options["listen"] or LOOPBACK)
    return filled(
        StreamSettings,
        {name: value for name, value in options.items() if name != "sender"},
        host=host,
        port=port,
        flip=flip,
        senders=(*senders, *[""] * (max(len(outputs), 1) - len(senders))),
        pairing=parse_pairing(options["pairing"]) if options["pairing"] else None,
    )


def _record_streams(options: Options, settings: StreamSettings) -> int:
    """Record until a signal, or the time is over; returns the exit status.

    Raises FacemimeError if nothing came, or a take cannot be written.
    """
    outputs: list[Path] = options["output"]
    source = StreamSource(settings, every=True)
    unfinished = [unfinished_beside(output) for output in outputs]
    with (
        outputs_of([(output, {SUFFIX}) for output in outputs], {"the key": settings.key}, *unfinished),
        ExitStack() as stack,
    ):
        paths = [stack.enter_context(growing(path)) for path in unfinished]
        try:
            counts = _record(source, paths, options)
        finally:
            source.close()
        if not any(counts):
            raise FacemimeError(source.problem)
        for path, output, count in zip(paths, outputs, counts, strict=False):  # without outputs, one is counted
            if count:
                settle(path, output)
            else:
                tell(f"facemime: {output} was not written, as no data came from its sender.")
    return 0


def _record(source: StreamSource, paths: Sequence[Path], options: Options) -> list[int]:
    """Record what comes into a take for each sender, if there are takes; returns the numbers of frames."""
    progress = Progress(f"Receiving {source.name}")
    end = monotonic() + (float("inf") if options["seconds"] is None else options["seconds"])
    screen = Screen() if options["watch"] else None
    counts = [0] * max(len(paths), 1)
    writers: dict[int, TakeWriter] = {}
    first, last, told = 0.0, monotonic(), ""
    with STOPPING.noting():
        while not STOPPING.heard and monotonic() < end:
            frame, told = _read(source, told, begun=any(counts))
            if frame is not None and not frame.filled and frame.result is not None:
                number = frame.heads[0] if frame.heads else 0
                first = first if any(counts) else frame.time
                if paths and number not in writers:
                    writers[number] = TakeWriter(paths[number], _description(source, frame))
                if frame.time >= first:
                    counts[number] += 1
                    if paths:
                        writers[number].append(frame.time - first, frame.result)
            if monotonic() - last > _FLUSH:
                for writer in writers.values():
                    writer.flush()
                last = monotonic()
            if screen is None:
                progress.update(sum(counts))
            else:
                screen.show(table(source.incoming) or told or "Waiting for the first frame")
        for writer in writers.values():
            writer.close()
    progress.done = sum(counts)
    progress.finish(_what_came(source))
    return counts


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
        tell(f"facemime: {for_terminal(message)}")
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
