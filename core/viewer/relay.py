"""Sends frames once to a relay, which passes them on to any number of viewers."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

from ..drive.driver import HeadDriver, HeadFrame
from ..errors import Message, OutputError
from ..heads.appearance import Appearance
from ..puppet.outputs import KeyDriver
from ..streams.transport.background import Serving
from .messages import PONG, NatsError, NatsReader, connecting, encode_frame, publishing
from .model import Scene, ViewerModel
from .site import SENDER, SUBJECT, Site

_AGAIN = 1.0
"""Seconds between two attempts to connect."""
_OPENING = 5.0
"""Seconds for the connection to be established."""
_ANSWERING = 5.0
"""Seconds for the answer to the credentials."""
_CLOSING = 0.5
"""Seconds for the connection to close."""
_MAX_MESSAGE = 65536
"""Largest size in bytes of a message from the relay."""


class RelaySender(Serving):
    """Sends frames to a relay until `close`, with the heads in the order of the worker's. See `Display`.

    Attributes
    ----------
    follow : (bool, bool)
        Whether the heads follow the performer's rotation and translation.
    shown : int
        Number of frames that were passed to the sender; the newest of them are sent.
    sent : int
        Number of frames sent.
    message : str
        Reason why nothing is sent; otherwise "".
    """

    def __init__(self, site: Site, appearances: Sequence[Appearance]) -> None:
        super().__init__("facemime-relay")
        self.follow = (True, False)
        self.shown = self.sent = 0
        self.message: str = ""
        self._site = site
        self._scene = Scene(appearances)
        self._changed: tuple[int, str, tuple[ViewerModel, ...]] | None = None
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
        if changed:
            self._call(partial(self._replace, number, scene.path, scene.models))
        self._call(partial(self._publish, frame))

    async def _run(self) -> None:
        over = asyncio.create_task(self._over.wait())
        while not over.done():
            session = asyncio.create_task(self._session())
            await asyncio.wait((session, over), return_when=asyncio.FIRST_COMPLETED)
            session.cancel()
            with suppress(asyncio.CancelledError):
                await session
            await asyncio.wait((over,), timeout=_AGAIN)

    async def _session(self) -> None:
        """Connect, and send until the connection is lost; errors become a message."""
        url = self._site.relay.url
        try:
            # All in one thread: a TLS connection that one thread reads while another writes is now and then corrupted.
            async with connect(
                url,
                ssl=self._context(),
                open_timeout=_OPENING,
                close_timeout=_CLOSING,
                compression=None,
                max_size=_MAX_MESSAGE,
                proxy=None,
            ) as connection:
                await connection.send(connecting(SENDER, self._site.password))
                reader = NatsReader()
                async with asyncio.timeout(_ANSWERING):
                    await _answer(connection, reader, until="PONG")
                self.message = self._scene.message
                await self._feed(connection, reader)
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

    def _context(self) -> ssl.SSLContext | None:
        """Return what the relay's certificate is checked with, which may be signed by itself; None without TLS."""
        if not self._site.relay.url.startswith("wss:"):
            return None
        context = ssl.create_default_context()
        if self._site.relay.certificate is not None:
            context.load_verify_locations(self._site.relay.certificate)
        return context

    def _replace(self, number: int, path: str, models: tuple[ViewerModel, ...]) -> None:
        self._changed = number, path, models

    async def _feed(self, connection: ClientConnection, reader: NatsReader) -> None:
        """Send the newest frame whenever the last one has been sent; the files of its scene are written before."""
        last, wake = b"", asyncio.Event()
        self._wakes.add(wake)
        answering = asyncio.create_task(_answer(connection, reader))
        answering.add_done_callback(lambda _: wake.set())
        try:
            while not answering.done():
                wake.clear()
                if self._changed is not None:
                    self._site.write(*self._changed)
                    self._changed = None
                    self.message = self._scene.message
                elif self._frame and self._frame is not last:
                    last = self._frame
                    await connection.send(publishing(SUBJECT, last))
                    self.sent += 1
                else:
                    await wake.wait()
            await answering
        finally:
            self._wakes.discard(wake)
            answering.cancel()


async def _answer(connection: ClientConnection, reader: NatsReader, until: str = "") -> None:
    """Answer the relay's questions whether this client is alive until it sends `until`; NatsError if it refuses."""
    while True:
        message = await connection.recv()
        for operation in reader.feed(message.encode() if isinstance(message, str) else message):
            if operation.verb == until:
                return
            if operation.verb == "PING":
                await connection.send(PONG)
            elif operation.verb == "-ERR":
                raise NatsError(operation.arguments.strip("'")[:200].lower())
