"""The server of the viewer: one page, and a stream of frames to everybody who has its address.

It runs in a thread of its own, so the worker never waits. A slow viewer gets the newest frame when it is ready, never
an old one.
"""

from __future__ import annotations

import asyncio
import gzip
import logging
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from http import HTTPStatus
from time import perf_counter
from typing import Any

from websockets.asyncio.server import Server, ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.server import ServerProtocol

from ..drive.driver import HeadDriver, HeadFrame
from ..heads.appearance import Appearance
from ..puppet.outputs import KeyDriver
from ..streams.transport.addresses import cannot_listen, listening
from ..streams.transport.background import Serving
from .gate import MAX_CONNECTIONS, Gate, Guest
from .messages import CLOCK_REQUEST, encode_clock, encode_frame
from .model import Scene, ViewerModel, description
from .page import Content, page_files, security_headers
from .viewer_settings import MAX_VIEWERS, ViewerSettings, new_token, same_token

_STREAM = "stream"
_MAX_MESSAGE = 64
"""Largest size in bytes of a message from a page, which only asks for the time."""
_MIN_PAUSE = 0.05
"""Smallest time in seconds between two such messages; a page that asks more often is disconnected."""
_STARTING = 10.0
"""Seconds for the server to start."""
_REQUEST = 5.0
"""Seconds for a request to arrive."""
_ANSWER = 120.0
"""Seconds for a page to take its answer."""
_CLOSING = 1.0
"""Seconds for a connection to close, and for a stranger to take its answer."""
_SEND_BUFFER = 65536
"""Bytes that may wait for a viewer, beyond those in the system's buffer, before frames are left out."""
_EFFORT = 1
"""Level at which gzip compresses models: 6 takes three times as long for 4 % less."""
_AGES = {True: "private, max-age=31536000, immutable", False: "no-store"}
"""How long browsers may keep a file whose name contains a digest of it, and others."""
_LOG = logging.getLogger("facemime.viewer")
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False


class _Connection(ServerConnection):
    """A connection of a browser, or of a stranger, and its place at the gate."""

    def __init__(self, server: Server, guest: Guest) -> None:
        super().__init__(
            ServerProtocol(max_size=_MAX_MESSAGE, logger=_LOG),
            server,
            close_timeout=_CLOSING,
            max_queue=4,
            write_limit=_SEND_BUFFER,
        )
        self.guest = guest


class ViewerServer(Serving):
    """Serves the page until `close`.

    Parameters
    ----------
    appearances : sequence of Appearance
        Appearance of each head, in the order of the worker's heads.

    Attributes
    ----------
    address : str
        Address of the page with its token; anybody who has it can watch.
    follow : (bool, bool)
        Whether the heads follow the performer's rotation and translation.
    viewers : int
        Number of connected pages.
    sent : int
        Number of frames that were passed to the server.
    message : str
        Reason why nothing is shown; otherwise "".

    Raises
    ------
    SourceError
        If the address cannot be listened on, or the certificate cannot be used.
    ModelError
        If the page is incomplete.
    """

    def __init__(self, settings: ViewerSettings, appearances: Sequence[Appearance]) -> None:
        self.settings = settings
        self.follow = (True, False)
        self.viewers = self.sent = 0
        self.message = self.address = ""
        self._token = settings.token or new_token()
        self._scene = Scene(appearances)
        self._files = page_files()
        self._context = settings.context()
        self._listener = listening(settings.host, settings.port, MAX_CONNECTIONS)
        super().__init__("facemime-viewer")
        self._served: tuple[int, str, tuple[ViewerModel, ...]] = (0, "", ())
        self._packed: dict[str, asyncio.Task[bytes]] = {}
        self._ready = threading.Event()
        self._error: OSError | None = None
        self._thread.start()
        if not self._ready.wait(_STARTING) or self._error is not None:
            self.close()
            raise cannot_listen(settings.host, settings.port, self._error or TimeoutError("it does not start"))

    def show(self, taken: float, drivers: Sequence[HeadDriver | KeyDriver], frames: Sequence[HeadFrame]) -> None:
        """Show a frame. See `Display.show`."""
        if not frames:
            return
        scene = self._scene
        if scene.update(drivers):
            self.message = scene.message
            self._call(partial(self._replace, scene.number, scene.path, scene.models))
        if not scene.models:
            return
        self.sent += 1
        frame = encode_frame(scene.number, self.sent, taken, scene.models, frames, self.follow)
        self._call(partial(self._publish, frame))

    # The methods below run in the server's thread.

    async def _run(self) -> None:
        try:
            await self._serve()
        except OSError as error:
            self._error = error
        finally:
            self._ready.set()

    async def _serve(self) -> None:
        self._loop.set_exception_handler(lambda loop, context: _LOG.debug("%s", context.get("message")))
        server = Server(self._admit, self._attend, _LOG)  # type: ignore[arg-type]  # a gate has what it uses
        self._connect = partial(_Connection, server)
        async with server:
            self.address = self._address(server)
            self._ready.set()
            self._ended = self._loop.create_task(self._over.wait())
            await self._ended
        await self._loop.shutdown_default_executor()

    async def _admit(self) -> Gate:
        self._gate = Gate(self._listener, self._connect, self._context)
        return self._gate

    async def _attend(self, connection: ServerConnection) -> None:
        """Answer a connection, and close it."""
        assert isinstance(connection, _Connection)
        guest, server = connection.guest, connection.server
        try:
            async with asyncio.timeout(_REQUEST):
                await asyncio.wait(
                    [connection.request_rcvd, connection.connection_lost_waiter], return_when=asyncio.FIRST_COMPLETED
                )
            if connection.request is None:
                return
            if (answer := await self._answer(guest, connection.request)) is not None:
                await self._send(connection, answer)
                return
            async with connection.send_context(expected_state=State.CONNECTING):
                connection.protocol.send_response(connection.protocol.accept(connection.request))
            if connection.protocol.state is State.OPEN:
                server.all_connections.add(connection)
                connection.start_keepalive()
                async with connection:
                    await self._watch(connection)
        except (OSError, TimeoutError, ConnectionClosed) as error:
            _LOG.debug("A connection of %s ended: %s", guest.host, error)
        finally:
            connection.transport.abort()
            server.all_connections.discard(connection)
            server.handler_tasks.discard(asyncio.current_task())
            self._gate.leave(guest)

    async def _send(self, connection: _Connection, answer: Response) -> None:
        """Send an answer, and wait until the other side has closed the connection; strangers get little time."""
        transport = connection.transport
        transport.write(answer.serialize())
        if transport.can_write_eof():
            transport.write_eof()
        else:
            transport.close()
        waits: list[asyncio.Future[Any]] = [connection.connection_lost_waiter, self._ended]
        patience = _ANSWER if connection.guest.welcome else _CLOSING
        await asyncio.wait(waits, timeout=patience, return_when=asyncio.FIRST_COMPLETED)

    def _address(self, server: Server) -> str:
        port = next(iter(server.sockets)).getsockname()[1]
        return f"{self.settings.scheme}://{self.settings.shown_host()}:{port}/{self._token}/"

    def _replace(self, scene: int, path: str, models: tuple[ViewerModel, ...]) -> None:
        if path != self._served[1]:
            self._packed = {}
        self._served = scene, path, models
        self._publish(b"")

    async def _answer(self, guest: Guest, request: Request) -> Response | None:
        """Answer a request, or return None to begin a stream."""
        if request.method != "GET":
            return _response(HTTPStatus.METHOD_NOT_ALLOWED, "text/plain", b"Only GET.\n", {"Allow": "GET"})
        host = _header(request, "Host")
        if not self.settings.allows(host):
            return _response(HTTPStatus.MISDIRECTED_REQUEST, "text/plain", b"This is not a name of this computer.\n")
        _, token, path = (*request.path.split("?")[0].split("/", 2), "", "")[:3]
        if not same_token(token, self._token):
            return _response(HTTPStatus.NOT_FOUND, "text/plain", b"There is nothing here.\n")
        guest.welcome = True
        if path == _STREAM:
            return self._refused(request, host)
        packs = "gzip" in _header(request, "Accept-Encoding").replace(",", " ").replace(";", " ").split()
        found = await self._content(path, packs=packs)
        if found is None:
            return _response(HTTPStatus.NOT_FOUND, "text/plain", b"There is nothing here.\n")
        headers = security_headers(host, secure=self._context is not None)
        headers |= {"Cache-Control": _AGES[found.lasting], "Vary": "Accept-Encoding"}
        if packs and found.packed is not None:
            return _response(HTTPStatus.OK, found.kind, found.packed, headers | {"Content-Encoding": "gzip"})
        return _response(HTTPStatus.OK, found.kind, found.data, headers)

    def _refused(self, request: Request, host: str) -> Response | None:
        """Refuse a stream to a page of another site, or beyond the largest number of viewers."""
        origin = _header(request, "Origin")
        if origin and origin.lower() != f"{self.settings.scheme}://{host}".lower():
            return _response(HTTPStatus.FORBIDDEN, "text/plain", b"Another site asks.\n")
        if self.viewers >= MAX_VIEWERS:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, "text/plain", b"There are too many viewers.\n")
        return None

    async def _content(self, path: str, *, packs: bool) -> Content | None:
        """Return a file of the page, or `PATH/HEAD/model` or `PATH/HEAD/IMAGE` of the served heads."""
        if path in self._files:
            return self._files[path]
        _, place, models = self._served
        parts = path.split("/")
        if len(parts) != 3 or not place or parts[0] != place:
            return None
        number = _index(parts[1], len(models))
        if number is None:
            return None
        if parts[2] == "model":
            data = models[number].data
            return Content(
                "application/octet-stream", data, await self._pack(path, data) if packs else None, lasting=True
            )
        image = _index(parts[2], len(models[number].images))
        return None if image is None else _image(models[number].images[image])

    async def _pack(self, path: str, data: bytes) -> bytes:
        """Compress a model, once for all pages."""
        if path not in self._packed:
            self._packed[path] = self._loop.create_task(asyncio.to_thread(gzip.compress, data, _EFFORT, mtime=0))
        return await asyncio.shield(self._packed[path])

    async def _watch(self, connection: ServerConnection) -> None:
        if self.viewers >= MAX_VIEWERS:  # several came at once
            return
        self.viewers += 1
        stream = self._loop.create_task(self._stream(connection))
        try:
            with suppress(ConnectionClosed):
                await self._tell_time(connection)
        finally:
            self.viewers -= 1
            stream.cancel()

    async def _stream(self, connection: ServerConnection) -> None:
        """Send the list of heads, then the newest frame whenever the last one has been sent, until the page closes."""
        scene, last, wake = -1, b"", asyncio.Event()
        self._wakes.add(wake)
        try:
            while True:
                wake.clear()
                if scene != self._served[0]:
                    scene, path, models = self._served
                    await connection.send(description(scene, path, models))
                elif self._frame and self._frame is not last:
                    last = self._frame
                    await connection.send(last)
                else:
                    await wake.wait()
        except ConnectionClosed:
            pass
        finally:
            self._wakes.discard(wake)

    async def _tell_time(self, connection: ServerConnection) -> None:
        """Answer requests for the time until the page closes; disconnect it if it sends anything else, or too often."""
        last = float("-inf")
        async for message in connection:
            now = perf_counter()
            if not isinstance(message, bytes) or len(message) != CLOCK_REQUEST.size or now - last < _MIN_PAUSE:
                await connection.close(1008)
                return
            last = now
            (sent,) = CLOCK_REQUEST.unpack(message)
            await connection.send(encode_clock(sent, now))


def _header(request: Request, name: str) -> str:
    """Return a header; one that comes twice is not a host or an origin."""
    return ", ".join(request.headers.get_all(name))


def _index(text: str, count: int) -> int | None:
    return int(text) if text.isdecimal() and len(text) < 5 and int(text) < count else None


def _image(data: bytes) -> Content:
    kinds = {b"\x89PNG": "image/png", b"RIFF": "image/webp"}
    return Content(kinds.get(data[:4], "image/jpeg"), data, lasting=True)


def _response(status: HTTPStatus, kind: str, body: bytes, extra: dict[str, str] | None = None) -> Response:
    headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close", **(extra or {})}
    return Response(status.value, status.phrase, Headers(headers), body)
