"""Admission to a server: few connections at a time, so that strangers who keep many open lock nobody out.

A connection that has not proved to be welcome gives way to newer ones, the oldest first. So the server never uses more
of the program's file descriptors than its share, and a page loads however many connections a stranger opens.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import ssl
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

MAX_CONNECTIONS = 64
MAX_STRANGERS = 12
"""Largest number of connections from one address that are not welcome yet; a browser opens up to six for each page that
it loads."""
_SHARE = 4
"""The largest number is at most this part of the file descriptors that the program may have; macOS allows 256."""
_HANDSHAKE = 5.0
"""Seconds for the handshake of TLS."""
_CLOSING = 1.0
"""Seconds for the end of TLS."""
_PAUSE = 0.5
"""Seconds until another attempt if no file descriptors are left."""
_LOG = logging.getLogger("facemime.viewer")


def capacity() -> int:
    """Return the largest number of connections at a time in this process."""
    try:
        import resource
    except ImportError:  # Windows, which has no such limit
        return MAX_CONNECTIONS
    allowed = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return MAX_CONNECTIONS if allowed == resource.RLIM_INFINITY else max(min(MAX_CONNECTIONS, allowed // _SHARE), 8)


@dataclass(eq=False)
class Guest:
    """A connection from a host; it is `welcome`, so that it stays, once it has shown the token."""

    host: str
    connection: socket.socket
    task: asyncio.Task[None] | None = None
    transport: asyncio.Transport | None = None
    welcome: bool = False
    begun: bool = False

    def end(self) -> None:
        """Close the connection at once."""
        if self.transport is not None:
            self.transport.abort()
            return
        if self.task is not None:
            self.task.cancel()
        if not self.begun:  # a task that is cancelled before it has begun closes nothing
            self.connection.close()


class Gate:
    """Listens on a socket and admits connections; has the interface of `asyncio.Server` that websockets uses.

    The listening socket does not block, and is closed at the end. `protocol` creates the protocol of a connection.
    """

    def __init__(
        self, listener: socket.socket, protocol: Callable[[Guest], asyncio.Protocol], context: ssl.SSLContext | None
    ) -> None:
        self.sockets = (listener,)
        self._protocol = protocol
        self._secure: dict[str, Any] = (
            {} if context is None else {"ssl_handshake_timeout": _HANDSHAKE, "ssl_shutdown_timeout": _CLOSING}
        )
        self._context = context
        self._capacity = capacity()
        self._guests: dict[Guest, None] = {}
        self._loop = asyncio.get_running_loop()
        self._accepting = self._loop.create_task(self._accept())

    def get_loop(self) -> asyncio.AbstractEventLoop:
        """Return the event loop."""
        return self._loop

    def is_serving(self) -> bool:
        """Return whether connections are accepted."""
        return not self._accepting.done()

    def close(self) -> None:
        """Accept no more connections, and end those that have not been welcomed."""
        self._accepting.cancel()
        for guest in [guest for guest in self._guests if not guest.welcome]:
            guest.end()

    async def wait_closed(self) -> None:
        """Wait until no more connections are accepted."""
        await asyncio.wait([self._accepting])
        self.sockets[0].close()

    def leave(self, guest: Guest) -> None:
        """Forget a connection that has been closed."""
        self._guests.pop(guest, None)

    async def _accept(self) -> None:
        while True:
            try:
                connection, address = await self._loop.sock_accept(self.sockets[0])
            except OSError:  # gone already, or the program has no file descriptor left
                await asyncio.sleep(_PAUSE)
                continue
            guest = Guest(str(address[0]), connection)
            if not self._make_room(guest.host):
                connection.close()
                continue
            self._guests[guest] = None
            guest.task = self._loop.create_task(self._connect(guest))
            await asyncio.sleep(0)  # one that waits already is accepted without a pause

    def _make_room(self, host: str) -> bool:
        """End the oldest stranger if there are too many; returns whether another connection is possible."""
        strangers = [guest for guest in self._guests if not guest.welcome]
        near = [guest for guest in strangers if guest.host == host]
        if len(near) >= MAX_STRANGERS or len(self._guests) >= self._capacity:
            if not strangers:
                return False
            oldest = (near if len(near) >= MAX_STRANGERS else strangers)[0]
            self.leave(oldest)
            oldest.end()
        return True

    async def _connect(self, guest: Guest) -> None:
        guest.begun = True
        try:
            guest.transport, _ = await self._loop.connect_accepted_socket(
                lambda: self._protocol(guest), guest.connection, ssl=self._context, **self._secure
            )
        except (OSError, EOFError, TimeoutError) as error:
            _LOG.debug("A connection of %s ended: %s", guest.host, error)
        finally:
            if guest.transport is None:
                with suppress(OSError):
                    guest.connection.close()
                self.leave(guest)
