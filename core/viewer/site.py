"""The viewer as static files for any web server, and the configuration of the relay whose stream they show."""

from __future__ import annotations

import html
import json
import os
import re
import secrets
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from ..errors import OutputError, SourceError
from ..files.owner_only import write_secret
from ..files.reading import read_bytes
from ..files.writing import replacing
from ..streams.transport.addresses import EVERYWHERE, LOOPBACK, is_loopback
from .messages import MAX_PAYLOAD
from .model import ViewerModel, description
from .page import content_policy, page_files

SUBJECT = "facemime"
"""Subject of the frames."""
SENDER = "sender"
"""User of the relay that sends the frames."""
VIEWER = "viewer"
"""User of the relay that receives them."""
_SECRETS = "secrets.json"
_CONFIGURATION = "relay.conf"
_PUBLIC = "site"
"""Folder that a web server has to publish."""
_PORTS = {"ws": 80, "wss": 443}
_TOKEN = re.compile(r"[0-9a-f]{32}")
_MAX_SECRETS = 1024
_CONFIGURED = """\
# The relay of a performance. Start it with: nats-server --config relay.conf
host: 127.0.0.1
port: -1
max_connections: 16384
max_payload: {payload}
# Bytes that may wait for a viewer, about two seconds; it is then disconnected, and comes back to the newest frame.
max_pending: {pending}
write_deadline: "2s"
ping_interval: "20s"
ping_max: 2
websocket {{
  host: "{host}"
  port: {port}
  {security}
  handshake_timeout: "5s"
}}
authorization {{
  timeout: 5
  users: [
    {{ user: {sender}, password: "{send}", permissions: {{ publish: ["{subject}"], subscribe: {{ deny: [">"] }} }} }}
    {{ user: {viewer}, password: "{watch}", permissions: {{ publish: {{ deny: [">"] }}, subscribe: ["{subject}"] }} }}
  ]
}}
"""
_PENDING = 2 * MAX_PAYLOAD


@dataclass(frozen=True)
class Relay:
    """A NATS server that passes frames on to any number of viewers.

    Attributes
    ----------
    url : str
        Address of its WebSocket, ws:// or wss://.
    certificate, key : Path or None
        PEM files of a certificate and its private key, if the relay itself shall use TLS.
    """

    url: str
    certificate: Path | None = None
    key: Path | None = None

    def checked(self) -> Relay:
        """Return the relay if its address can be used; SourceError otherwise."""
        try:
            parts = urlsplit(self.url)
            port = parts.port
        except ValueError:
            parts, port = urlsplit(""), None
        known = parts.scheme in _PORTS and bool(parts.hostname) and port != 0
        if not known or parts.username or parts.query or parts.fragment or not re.fullmatch(r"[!-~]+", self.url):
            raise SourceError(
                "{url!r} is not the address of a relay. Use ws://HOST:PORT, or wss://HOST:PORT for HTTPS.", url=self.url
            )
        if (self.certificate is None) != (self.key is None):
            raise SourceError("A relay needs a certificate with its private key. Give both, or neither.")
        return self

    def configuration(self, send: str, watch: str) -> str:
        """Return the configuration for nats-server, with the passwords of the sender and of the viewers."""
        parts = urlsplit(self.url)
        security = "no_tls: true"
        if self.certificate is not None and self.key is not None:
            files = [json.dumps(str(path.resolve())) for path in (self.certificate, self.key)]
            security = f"tls {{ cert_file: {files[0]}, key_file: {files[1]} }}"
        return _CONFIGURED.format(
            payload=MAX_PAYLOAD,
            pending=_PENDING,
            host=LOOPBACK if is_loopback(parts.hostname or "") else EVERYWHERE,
            port=parts.port or _PORTS[parts.scheme],
            security=security,
            subject=SUBJECT,
            sender=SENDER,
            viewer=VIEWER,
            send=send,
            watch=watch,
        )


class Site:
    """A folder with the secrets and the configuration of a relay, and the page in a folder to publish.

    Parameters
    ----------
    folder : Path
        The folder, created if it does not exist.

    Attributes
    ----------
    public : Path
        The folder to publish.
    page : Path
        Folder of the page in it, whose name is secret.
    configuration : Path
        Configuration for nats-server, which contains secrets.
    password : str
        Password of the sender.

    Raises
    ------
    SourceError
        If the address of the relay or the stored secrets cannot be used.
    OutputError
        If the folder cannot be written.
    ModelError
        If the page is incomplete.
    """

    def __init__(self, folder: Path, relay: Relay) -> None:
        self.relay = relay.checked()
        files = page_files()
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.password, watch = _secrets(folder / _SECRETS)
            self.configuration = folder / _CONFIGURATION
            write_secret(self.configuration, relay.configuration(self.password, watch).encode(), replace=True)
        except OSError as error:
            raise OutputError(
                "The site cannot be written to {folder} ({reason}). Choose another folder.",
                folder=folder,
                reason=error.strerror,
            ) from error
        self.public = folder / _PUBLIC
        self.page = self.public / watch
        for name, content in files.items():
            _write(self.page / (name or "index.html"), content.data if name else self._index(content.data, watch))

    def write(self, number: int, path: str, models: tuple[ViewerModel, ...]) -> None:
        """Write a scene: its models first, so that pages find them; raises OutputError if it cannot be written."""
        for head, model in enumerate(models):
            _write(self.page / path / str(head) / "model", model.data)
            for image, data in enumerate(model.images):
                _write(self.page / path / str(head) / str(image), data)
        _write(self.page / "scene.json", description(number, path, models).encode())

    def _index(self, page: bytes, watch: str) -> bytes:
        """Return the page with the relay, and with the policy that a server would send as a header."""
        relay, policy = html.escape(self.relay.url), html.escape(content_policy(self.relay.url))
        text = page.decode().replace("<html", f'<html data-relay="{relay}" data-password="{watch}"', 1)
        text = text.replace("<head>", f'<head>\n<meta http-equiv="Content-Security-Policy" content="{policy}">', 1)
        return text.encode()


def _secrets(path: Path) -> tuple[str, str]:
    """Read the passwords of the sender and of the viewers; make them the first time."""
    if not os.path.lexists(path):
        made = {name: secrets.token_hex(16) for name in ("send", "watch")}
        write_secret(path, json.dumps(made).encode())
    try:
        stored = json.loads(read_bytes(path, _MAX_SECRETS))
        found = str(stored["send"]), str(stored["watch"])
    except (ValueError, KeyError, TypeError) as error:
        raise SourceError(
            "The secrets in {path} cannot be read ({error}). Delete the folder.", path=path, error=error
        ) from error
    if not all(map(_TOKEN.fullmatch, found)):
        raise SourceError("The secrets in {path} are not valid. Delete the folder.", path=path)
    return found


def _write(path: Path, data: bytes) -> None:
    """Write a file, unless it has this content already."""
    try:
        if path.stat().st_size == len(data) and path.read_bytes() == data:
            return
    except OSError:
        pass
    with replacing(path) as temporary:
        temporary.write_bytes(data)
        temporary.chmod(0o644)
