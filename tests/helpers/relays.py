"""A real relay for tests: nats-server, started as the documentation says."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from websockets.sync.client import ClientConnection, connect

from facemime.core.viewer.messages import PING, NatsReader, Operation, connecting, subscribing
from facemime.core.viewer.site import SUBJECT, VIEWER, Relay, Site
from tests.helpers.clocks import PATIENCE
from tests.helpers.links import free_port
from tests.helpers.programs import program


def new_site(folder: Path) -> Site:
    """A site whose relay is at a free port of this computer."""
    return Site(folder, Relay(f"ws://127.0.0.1:{free_port()}"))


@contextmanager
def relaying(site: Site) -> Iterator[subprocess.Popen]:
    """Run the relay of a site until the end of the context; it is ready."""
    with subprocess.Popen(
        [program("nats-server"), "--config", str(site.configuration)], stderr=subprocess.PIPE, text=True
    ) as server:
        try:
            for line in server.stderr:
                if "Server is ready" in line:
                    break
            else:
                raise AssertionError("the relay does not start")
            yield server
        finally:
            server.terminate()


@contextmanager
def watching(site: Site, user: str = VIEWER, subject: str = SUBJECT, password: str = "") -> Iterator["Viewer"]:
    """A viewer that has subscribed, as the page does."""
    with connect(site.relay.url, compression=None, proxy=None) as connection:
        connection.send(connecting(user, password or site.page.name) + subscribing(subject) + PING)
        yield Viewer(connection)


class Viewer:
    """Reads the operations that a relay sends, once it has accepted or refused the subscription."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection, self._reader, self._pending = connection, NatsReader(), []
        pongs = 0
        while pongs < 2 and not any(operation.verb == "-ERR" for operation in self._pending):
            came = self._came(PATIENCE)
            pongs += sum(operation.verb == "PONG" for operation in came)
            self._pending += came

    def next(self, verb: str, seconds: float) -> bytes | str:
        """Return the payload of the next message, or the arguments of another operation; TimeoutError if none comes."""
        while True:
            while self._pending:
                operation = self._pending.pop(0)
                if operation.verb == verb:
                    return operation.payload or operation.arguments
            self._pending = self._came(seconds)

    def _came(self, seconds: float) -> list[Operation]:
        return self._reader.feed(self.connection.recv(seconds))
