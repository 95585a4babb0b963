"""Sends frames once to a relay, which passes them on to any number of viewers."""

from __future__ import annotations

from collections.abc import Sequence

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from ..drive.driver import HeadDriver, HeadFrame
from ..errors import Message, OutputError
from ..heads.appearance import Appearance
from ..puppet.outputs import KeyDriver
from ..streams.transport.background import Connecting
from .messages import PONG, NatsError, NatsReader, Operation, connecting, encode_frame, publishing
from .model import Scene, ViewerModel
from .site import SENDER, SUBJECT, Site

_AGAIN = 1.0
"""Seconds between two attempts to connect."""
_LOOK = 0.5
"""Seconds without a frame until the relay's own requests are answered."""
_OPENING = 5.0
"""Seconds for the connection to be established."""
_ANSWERING = 5.0
"""Seconds for the answer to the credentials."""
_CLOSING = 0.5
"""Seconds for the connection to close."""
_MAX_MESSAGE = 65536
"""Largest size in bytes of a message from the relay."""


class RelaySender(Connecting):
    """Sends frames to a relay until `close`, with the heads in the order of the worker's. See `Display`.

    Attributes
    ----------
    follow : (bool, bool)
        Whether the heads follow the performer's rotation and translation.
    shown : int
        Number of frames that were passed to the sender; the newest of them are sent.
    """

    def __init__(self, site: Site, appearances: Sequence[Appearance]) -> None:
        super().__init__("facemime-relay", _AGAIN)
        self.follow = (True, False)
        self._site = site
        self._scene = Scene(appearances)
        self._changed: tuple[int, str, tuple[ViewerModel, ...]] | None = None
        self._frame, self._fresh = b"", False
        self.shown = 0
        self._thread.start()

    def show(self, taken: float, drivers: Sequence[HeadDriver | KeyDriver], frames: Sequence[HeadFrame]) -> None:
        """Show a frame. See `Display.show`."""
        if not frames:
            return
        scene = self._scene
        changed = scene.update(drivers)
        self.shown += 1
        # By this number, pages learn of another scene; the same heads have the same one after a restart.
        number = int(scene.path[:4], 16)
        frame = encode_frame(number, self.shown, taken, scene.models, frames, self.follow) if scene.models else b""
        with self._news:
            if changed:
                self._changed = number, scene.path, scene.models
            self._frame, self._fresh = frame, True
            self._news.notify()

    def _connect(self) -> None:
        url = self._site.relay.url
        try:
            with connect(
                url,
                open_timeout=_OPENING,
                close_timeout=_CLOSING,
                compression=None,
                max_size=_MAX_MESSAGE,
                proxy=None,
            ) as connection:
                reader = NatsReader()
                self._greet(connection, reader)
                self.message = self._scene.message
                self._feed(connection, reader)
        except NatsError as error:
            self.message = Message(
                "The relay {url} refused: {error}. Run: nats-server --config {configuration}",
                url=url,
                error=error,
                configuration=self._site.configuration,
            )
        except OutputError as error:
            self.message = str(error)
        except (OSError, WebSocketException, ValueError):
            self.message = Message(
                "The relay {url} does not answer. Run: nats-server --config {configuration}",
                url=url,
                configuration=self._site.configuration,
            )

    def _greet(self, connection: ClientConnection, reader: NatsReader) -> None:
        """Show the password, and wait until the relay accepts it."""
        connection.send(connecting(SENDER, self._site.password))
        while True:
            for operation in reader.feed(_bytes(connection.recv(_ANSWERING))):
                if operation.verb == "PONG":
                    return
                _answer(connection, operation)

    def _feed(self, connection: ClientConnection, reader: NatsReader) -> None:
        """Send the newest frame whenever the last one has been sent; the files of its scene are written before."""
        self._fresh = True
        while True:
            with self._news:
                self._news.wait_for(lambda: self._over or self._fresh, _LOOK)
                if self._over:
                    return
                frame, changed = self._frame if self._fresh else b"", self._changed
                self._fresh = False
            if changed is not None:
                self._site.write(*changed)
                with self._news:
                    self._changed = None if self._changed is changed else self._changed
                self.message = self._scene.message
            if frame:
                connection.send(publishing(SUBJECT, frame))
                self.sent += 1
            _answer_all(connection, reader)


def _answer_all(connection: ClientConnection, reader: NatsReader) -> None:
    try:
        while True:
            for operation in reader.feed(_bytes(connection.recv(0))):
                _answer(connection, operation)
    except TimeoutError:
        return


def _answer(connection: ClientConnection, operation: Operation) -> None:
    """Answer the relay's question whether this client is alive; NatsError if it reports an error."""
    if operation.verb == "PING":
        connection.send(PONG)
    elif operation.verb == "-ERR":
        raise NatsError(operation.arguments.strip("'")[:200].lower())


def _bytes(message: str | bytes) -> bytes:
    return message.encode() if isinstance(message, str) else message
