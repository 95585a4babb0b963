"""The commands `send`, a face over the network, and `serve`, a head in browsers; the built-in head needs no Blender."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import FacemimeError
from ..core.heads.appearance import Appearance
from ..core.puppet.outputs import LiveHead
from ..core.puppet.worker import LiveWorker
from ..core.streams.sender import SENT, VTUBE_STUDIO, StreamSender
from ..core.streams.stream_settings import EXPRESSIONS, OWN, SendSettings
from ..core.streams.transport.addresses import LOOPBACK, parse_address
from ..core.streams.transport.addresses import PORT as TLS_PORT
from ..core.streams.vertices import VERTICES, VertexSender
from ..core.viewer.viewer_settings import PORT, ViewerSettings, as_text, kept_token, qr_code
from .console import Progress, say, tell
from .options import Commands, Options, add_command, add_key_option, filled
from .performance import LivePerformance, add_head_option, add_source, head_to_show, watch
from .stopping import STOPPING

if TYPE_CHECKING:
    from ..core.streams.transport.tls_server import TlsSender
    from ..core.streams.vtube_studio_api import VTubeStudioSender

    Sender = StreamSender | VertexSender | TlsSender | VTubeStudioSender
    from ..core.viewer.relay import RelaySender
    from ..core.viewer.server import ViewerServer


def add_send(commands: Commands) -> None:
    """Add the command to the parser."""
    send = add_command(commands, "send", "track a face, and send it to another computer or program")
    add_source(send, takes_as_recorded=True)
    add_head_option(send)
    where = send.add_mutually_exclusive_group(required=True)
    where.add_argument("--to", metavar="HOST[:PORT]", help="address to send to, as in 192.168.1.7:39539")
    where.add_argument(
        "--serve",
        metavar="HOST[:PORT]",
        help=f"wait for receivers over TLS at this address of this computer; 0.0.0.0 for all (port {TLS_PORT})",
    )
    send.add_argument(
        "--token",
        type=Path,
        metavar="FILE",
        help="file that stores the permission from VTube Studio (in your user settings)",
    )
    send.add_argument(
        "--tls", type=Path, metavar="FOLDER", help="folder of the certificate and token for --serve, created if missing"
    )
    send.add_argument(
        "--public", default="", metavar="HOST[:PORT]", help="address by which other networks reach this computer"
    )
    send.add_argument("--protocol", choices=(*SENT, VERTICES, VTUBE_STUDIO), default=OWN, help=f"protocol ({OWN})")
    add_key_option(send)
    send.add_argument(
        "--subject",
        default=SendSettings.subject,
        metavar="NAME",
        help=f"name of the face in Unreal ({SendSettings.subject})",
    )
    send.add_argument(
        "--expressions",
        choices=EXPRESSIONS,
        default=SendSettings.expressions,
        help=f"names of the expressions that move in VMC ({SendSettings.expressions})",
    )
    send.set_defaults(run=_run_send)


def _run_send(given: Options) -> int:
    """Run `facemime send`: track and send until the end, Ctrl-C, or the time is over; returns the exit status."""
    performance = filled(LivePerformance, given)
    open_output = _open_sender(given) if given["serve"] is None else _open_server(given)
    source, neutral = performance.open()
    worker = LiveWorker(source, neutral=neutral, options=performance.options)
    sender = open_output(worker)
    progress = Progress(f"Sending {source.name} to {given['to'] or 'receivers over TLS'}")
    with closing(sender), STOPPING.noting():
        watch(worker, lambda: (sender.sent, sender.message), progress, performance.seconds)
    progress.finish(sender.message or ("" if sender.sent else "nothing was sent, as nobody answered"))
    return 0


def _open_sender(given: Options) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker send what it tracks, or the vertices of the head that it drives."""
    if given["tls"] is not None or given["public"]:
        raise FacemimeError("--tls and --public are for --serve. Leave them out, or use --serve instead of --to.")
    if given["head"] is not None and given["protocol"] != VERTICES:
        raise FacemimeError(
            "--head is for --protocol vertices; other protocols send the face, not a head. Leave it out."
        )
    if given["protocol"] == VTUBE_STUDIO:
        return _open_vtube_studio(given)
    host, port = parse_address(given["to"] or "")
    settings = filled(SendSettings, given, host=host, port=port)
    if given["protocol"] == VERTICES:
        return _open_vertices(settings, *head_to_show(given["head"]))

    def open_output(worker: LiveWorker) -> Sender:
        worker.output = sender = StreamSender(settings)
        return sender

    return open_output


def _open_vertices(settings: SendSettings, head: LiveHead, appearance: Appearance) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker send the moved vertices of a head."""

    def open_output(worker: LiveWorker) -> Sender:
        vertices = VertexSender(settings.host, settings.port, [appearance])
        worker.heads, worker.displays = (head,), (vertices,)
        return vertices

    return open_output


def _open_vtube_studio(given: Options) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker send what it tracks to VTube Studio on a computer."""
    from ..core.streams.vtube_studio_api import VTubeStudioSender  # its libraries would delay the other commands

    host, port = parse_address(given["to"] or "")
    token = given["token"] or _user_settings() / "vtube_studio_token"

    def open_output(worker: LiveWorker) -> Sender:
        worker.output = sender = VTubeStudioSender(host, port, token)
        return sender

    return open_output


def _user_settings() -> Path:
    """Return the folder of the user's settings; FacemimeError if this user has no home."""
    place = os.environ.get("APPDATA") or os.environ.get("XDG_CONFIG_HOME")
    try:
        return (Path(place) if place else Path.home() / ".config") / "facemime"
    except RuntimeError as error:
        raise FacemimeError("There is no home folder to keep the permission in. Add --token FILE.") from error


def _open_server(given: Options) -> Callable[[LiveWorker], Sender]:
    """Return what makes a worker serve what it tracks over TLS, and shows the pairing line."""
    from ..core.streams.transport.security import load_identity
    from ..core.streams.transport.tls_server import TlsSender  # its libraries would delay the other commands

    if given["tls"] is None:
        raise FacemimeError("There is no certificate. Add --tls FOLDER; it is created there the first time.")
    if given["protocol"] != OWN or given["key"] is not None:
        raise FacemimeError("Over TLS, Facemime's own protocol is sent without a key. Leave out --protocol and --key.")
    host, port = parse_address(given["serve"], TLS_PORT)
    identity = load_identity(given["tls"])

    def open_output(worker: LiveWorker) -> Sender:
        worker.output = sender = TlsSender(host, port, identity.context, identity.token)
        say(identity.pairing(host, sender.port, given["public"]).line)
        tell("facemime: paste this line on the other computer. Anyone who has it can receive.")
        return sender

    return open_output


def add_serve(commands: Commands) -> None:
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
    serve.set_defaults(run=_run_serve)


def _run_serve(given: Options) -> int:
    """Run `facemime serve` until the end, Ctrl-C, or the time is over; returns the exit status."""
    if bool(given["relay"]) != (given["site"] is not None):
        raise FacemimeError("A relay needs a folder for its page. Give both --relay URL and --site FOLDER.")
    if given["relay"] and (given["listen"] or given["token"] is not None):
        raise FacemimeError("--listen and --token are for the viewer's own server. Leave them out, or --relay.")
    head, appearance = head_to_show(given["head"])
    performance = filled(LivePerformance, given)
    source, neutral = performance.open()
    server, announce = _server(given, appearance) if given["site"] is None else _relay(given, appearance)
    with server, STOPPING.noting():
        server.follow = (True, given["translation"])
        worker = LiveWorker(source, neutral=neutral, heads=(head,), options=performance.options)
        worker.displays = (server,)
        announce()
        progress = Progress(f"Serving {source.name}")
        watch(worker, lambda: (server.sent, server.message), progress, performance.seconds)
    progress.finish(server.message)
    return 0


def _server(given: Options, appearance: Appearance) -> tuple[ViewerServer, Callable[[], None]]:
    """Return the viewer's own server, and what prints the address of the page."""
    from ..core.viewer.server import ViewerServer  # its libraries would delay the other commands

    host, port = parse_address(given["listen"] or LOOPBACK, PORT)
    token = "" if given["token"] is None else kept_token(given["token"])
    server = ViewerServer(ViewerSettings(host, port, token, given["cert"], given["key"]), [appearance])
    return server, lambda: _announce(server)


def _relay(given: Options, appearance: Appearance) -> tuple[RelaySender, Callable[[], None]]:
    """Return the sender to the relay, and what prints the folder of the page, whose name is all that viewers need."""
    from ..core.viewer.relay import RelaySender
    from ..core.viewer.site import Relay, Site

    site = Site(given["site"], Relay(given["relay"], given["cert"], given["key"]))

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
