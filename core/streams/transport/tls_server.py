"""A sender over TLS: paired receivers connect to it, and get as many frames as they can take."""

from __future__ import annotations

import asyncio
import hmac
import logging
import socket
import ssl
from collections import Counter
from contextlib import suppress
from functools import partial

from ...takes.neutral import Neutral
from ...tracking.result import TrackResult
from . import datagram
from .addresses import ACCEPTED, ANSWER, GREETING, LENGTH, MAGIC, REFUSED, VERSION, listening
from .background import Serving
from .datagram import OwnSender

_PATIENCE = 5.0
"""Seconds for the handshake, and for the token."""
_ALIVE = 1.0
"""Largest pause between two messages in seconds."""
_STUCK = 10.0
"""Largest time to send one message in seconds."""
_MAX_CONNECTIONS = 32
_MAX_PER_ADDRESS = 4
"""Largest number of connections from one address that have not shown the token."""
_WAITING = 1 << 13
"""Bytes that may wait for a receiver, beyond those in the system's buffer, before frames are left out."""
_LOG = logging.getLogger(__name__)


class TlsSender(Serving):
    """Sends tracking results to receivers that show the pairing's token. See `core.puppet.outputs.Output`.

    Parameters
    ----------
    port : int
        Port of this computer to listen on; 0 for any free one. The attribute is the one that is listened on.
    context : ssl.SSLContext
        TLS context with the certificate.

    Attributes
    ----------
    receivers : int
        Number of connected receivers that have shown the token.
    sent : int
        Number of frames sent, to all receivers together.
    refused : int
        Number of refused connections.
    message : str
        Reason why nothing is sent; otherwise "".

    Raises
    ------
    SourceError
        If the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, context: ssl.SSLContext, token: bytes) -> None:
        self.receivers = self.sent = self.refused = 0
        self._context, self._token = context, token
        self._listener = listening(host, port, _MAX_CONNECTIONS)
        super().__init__("facemime-tls")
        self.port = int(self._listener.getsockname()[1])
        self._own = OwnSender(None)
        self._tasks: set[asyncio.Task[None]] = set()
        self._strangers: Counter[str] = Counter()
        self._thread.start()

    @property
    def message(self) -> str:
        """Reason why nothing is sent; otherwise ""."""
        return "" if self.receivers else "No receiver is connected. Paste the pairing line on the other computer."

    def send(
        self, time: float, result: TrackResult, neutral: Neutral | None, size: tuple[int, int] | None = None
    ) -> None:
        """Send a frame. See `Output.send`."""
        self._call(partial(self._publish, self._own.packet(*datagram.encode_face(result), max(time, 0.0))))

    # The methods below run in the server's thread.

    async def _run(self) -> None:
        accepting = self._loop.create_task(self._accept())
        await self._over.wait()
        tasks = [accepting, *self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._listener.close()

    async def _accept(self) -> None:
        while True:
            try:
                connection, address = await self._loop.sock_accept(self._listener)
            except OSError:  # too many open files, or gone already
                await asyncio.sleep(_ALIVE)
                continue
            host = str(address[0])
            if len(self._tasks) >= _MAX_CONNECTIONS or self._strangers[host] >= _MAX_PER_ADDRESS:
                self.refused += 1
                connection.close()
                continue
            self._strangers[host] += 1
            task = self._loop.create_task(self._attend(connection, host))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _attend(self, connection: socket.socket, host: str) -> None:
        """Greet a receiver, and send frames if it shows the token."""
        reader = asyncio.StreamReader(limit=GREETING.size)
        protocol = asyncio.StreamReaderProtocol(reader)
        transport: asyncio.WriteTransport | None = None
        try:
            try:
                transport, _ = await self._loop.connect_accepted_socket(
                    lambda: protocol,
                    connection,
                    ssl=self._context,
                    ssl_handshake_timeout=_PATIENCE,
                    ssl_shutdown_timeout=_ALIVE,
                )
                greeting = await asyncio.wait_for(reader.readexactly(GREETING.size), _PATIENCE)
                known = self._is_known(greeting)
            finally:
                self._strangers[host] -= 1
                self._strangers += Counter()  # drops addresses with none
            self.refused += not known
            transport.write(ANSWER.pack(MAGIC, VERSION, ACCEPTED if known else REFUSED))
            if known:
                await self._stream(reader, asyncio.StreamWriter(transport, protocol, reader, self._loop))
        except (OSError, EOFError, TimeoutError) as error:
            _LOG.debug("A connection of %s ended: %s", host, error)
        finally:
            connection.close() if transport is None else transport.close()

    def _is_known(self, greeting: bytes) -> bool:
        magic, version, token = GREETING.unpack(greeting)
        return magic == MAGIC and version == VERSION and hmac.compare_digest(token, self._token)

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Send the newest frame whenever the last one has been sent, until the receiver leaves, or sends anything."""
        writer.transport.set_write_buffer_limits(high=_WAITING)
        wake, last = asyncio.Event(), b""
        ended = self._loop.create_task(reader.read(1))
        self._wakes.add(wake)
        self.receivers += 1
        try:
            # Up to Python 3.11, `wait_for` swallows the cancellation of the task if the awaited object is done at the
            # same time.
            while not (ended.done() or self._over.is_set()):
                wake.clear()
                if (frame := self._frame) is not last:
                    last = frame
                    self.sent += 1
                else:
                    frame = b""
                writer.write(LENGTH.pack(len(frame)) + frame)
                await asyncio.wait_for(writer.drain(), _STUCK)
                with suppress(TimeoutError):
                    await asyncio.wait_for(wake.wait(), _ALIVE)
        finally:
            self.receivers -= 1
            self._wakes.discard(wake)
            ended.cancel()
