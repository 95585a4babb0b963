"""The command `serve`: a head in any browser, moved by a camera or a video; the built-in one needs no Blender."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import FacemimeError
from ..core.heads.appearance import Appearance
from ..core.live.worker import LiveWorker
from ..core.puppet.job import HeadFile
from ..core.streams.transport.addresses import LOOPBACK, parse_address
from ..core.viewer.qr import as_text, qr_code
from ..core.viewer.viewer_settings import PORT, ViewerSettings, kept_token
from .console import Progress, say, tell
from .options import Commands, add_command, filled
from .performance import LivePerformance, add_head_option, add_source, head_to_show, watch
from .stopping import STOPPING

if TYPE_CHECKING:
    from ..core.viewer.relay import RelaySender
    from ..core.viewer.server import ViewerServer


@dataclass(frozen=True)
class ServeJob:
    """A performance to show in browsers.

    Attributes
    ----------
    performance : LivePerformance
    head : HeadFile or None
        The head; None for the built-in one.
    listen : str
        Address of this computer, HOST[:PORT]; "" for this computer alone.
    cert, key : Path or None
        PEM files for HTTPS.
    token : Path or None
        File that keeps the secret in the address.
    relay : str
        Address of a relay to send to instead, ws:// or wss://; "" for none.
    site : Path or None
        Folder for its secrets and its page.
    translation : bool
        Whether the head moves as well as turns.
    """

    performance: LivePerformance
    head: HeadFile | None
    listen: str
    cert: Path | None
    key: Path | None
    token: Path | None
    relay: str
    site: Path | None
    translation: bool


def add_commands(commands: Commands) -> None:
    """Add the command to the parser."""
    serve = add_command(commands, "serve", "show a head that follows a face in browsers")
    add_source(serve)
    add_head_option(serve)
    serve.add_argument(
        "--listen",
        default="",
        metavar="HOST[:PORT]",
        help=f"address of this computer; 0.0.0.0 for all of its networks (this computer alone, port {PORT})",
    )
    serve.add_argument("--cert", type=Path, metavar="FILE.pem", help="certificate, for HTTPS")
    serve.add_argument("--key", type=Path, metavar="FILE.pem", help="private key of the certificate")
    serve.add_argument(
        "--token",
        type=Path,
        metavar="FILE",
        help="file that keeps the secret part of the address (a new secret each time)",
    )
    serve.add_argument(
        "--relay",
        default="",
        metavar="URL",
        help="send once to a NATS server at this address, ws:// or wss://, from which any number of browsers watch",
    )
    serve.add_argument(
        "--site", type=Path, metavar="FOLDER", help="folder for the relay's configuration and the page to publish"
    )
    serve.add_argument("--translation", action="store_true", help="also move the head, instead of only rotating it")
    serve.set_defaults(run=lambda given: run_serve(filled(ServeJob, given)))


def run_serve(job: ServeJob) -> int:
    """Run `facemime serve` until the end, Ctrl-C, or the time is over; returns the exit status."""
    if bool(job.relay) != (job.site is not None):
        raise FacemimeError("A relay needs a folder for its page. Give both --relay URL and --site FOLDER.")
    if job.relay and (job.listen or job.token is not None):
        raise FacemimeError("--listen and --token are for the viewer's own server. Leave them out, or --relay.")
    head, appearance = head_to_show(job.head)
    source, neutral = job.performance.open()
    server, announce = _server(job, appearance) if job.site is None else _relay(job, job.site, appearance)
    with server, STOPPING.noting():
        server.follow = (True, job.translation)
        worker = LiveWorker(source, neutral=neutral, heads=(head,), options=job.performance.options)
        worker.displays = (server,)
        announce()
        progress = Progress(f"Serving {source.name}")
        worker.start()
        try:
            watch(worker, lambda: (server.sent, server.message), progress, job.performance.seconds)
        finally:
            worker.close()
    if worker.error is not None:
        raise worker.error
    progress.finish(server.message)
    return 0


def _server(job: ServeJob, appearance: Appearance) -> tuple[ViewerServer, Callable[[], None]]:
    """Return the viewer's own server, and what prints the address of the page."""
    from ..core.viewer.server import ViewerServer  # its libraries would delay the other commands

    host, port = parse_address(job.listen or LOOPBACK, PORT)
    token = "" if job.token is None else kept_token(job.token)
    server = ViewerServer(ViewerSettings(host, port, token, job.cert, job.key), [appearance])
    return server, lambda: _announce(server)


def _relay(job: ServeJob, folder: Path, appearance: Appearance) -> tuple[RelaySender, Callable[[], None]]:
    """Return the sender to the relay, and what prints the folder of the page, whose name is all that viewers need."""
    from ..core.viewer.relay import RelaySender
    from ..core.viewer.site import Relay, Site

    site = Site(folder, Relay(job.relay, job.cert, job.key))

    def announce() -> None:
        say(str(site.page))
        tell(f"facemime: start the relay: nats-server --config {site.configuration}")
        tell(f"facemime: publish {site.public} with a web server. Anyone who has the address of the page can watch.")

    return RelaySender(site, [appearance]), announce


def _announce(server: ViewerServer) -> None:
    """Print the address of the page, which is all that is needed to watch."""
    say(server.address)
    if not server.settings.is_local:
        for line in as_text(qr_code(server.address)).split("\n"):
            tell(line)
    tell("facemime: open this address in a browser. Anyone who has it can watch.")
