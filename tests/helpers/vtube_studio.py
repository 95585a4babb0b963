"""VTube Studio on a computer, for tests: a real WebSocket server that follows the published interface."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from websockets.sync.server import ServerConnection, serve

TOKEN = "adcd-123-ef09-some-token-string-abcd"


class Studio:
    """Behaviour of VTube Studio: it asks its user, knows its tokens, and accepts parameters."""

    def __init__(self, *, allow: bool = True, tokens: tuple[str, ...] = (TOKEN,)) -> None:
        self.allow, self.tokens = allow, tokens
        self.requests: list[dict] = []
        self.times: list[float] = []
        self.connections: list[ServerConnection] = []

    def kinds(self) -> list[str]:
        return [request["messageType"] for request in self.requests]

    def injected(self) -> list[dict]:
        return [each["data"] for each in self.requests if each["messageType"] == "InjectParameterDataRequest"]

    def attend(self, connection: ServerConnection) -> None:
        self.connections.append(connection)
        known = False
        for message in connection:
            asked = json.loads(message)
            self.times.append(time.monotonic())
            self.requests.append(asked)
            assert asked["apiName"] == "VTubeStudioPublicAPI" and asked["apiVersion"] == "1.0"
            kind, data = asked["messageType"], asked["data"]
            if kind == "AuthenticationTokenRequest":
                if not self.allow:
                    self.answer(
                        connection, asked, "APIError", {"errorID": 50, "message": "User has denied API access."}
                    )
                    continue
                self.tokens = (TOKEN,)
                answered = {"authenticationToken": TOKEN}
            elif kind == "AuthenticationRequest":
                known = data["authenticationToken"] in self.tokens
                answered = {"authenticated": known, "reason": "Token valid." if known else "Token invalid."}
            elif not known:
                self.answer(connection, asked, "APIError", {"errorID": 8, "message": "Not authenticated."})
                continue
            else:
                answered = {}
            self.answer(connection, asked, kind.replace("Request", "Response"), answered)

    def answer(self, connection: ServerConnection, asked: dict, kind: str, data: dict) -> None:
        head = {"apiName": "VTubeStudioPublicAPI", "apiVersion": "1.0", "timestamp": 1625405710728}
        connection.send(json.dumps({**head, "requestID": asked["requestID"], "messageType": kind, "data": data}))


@contextmanager
def running(studio: Studio, port: int = 0) -> Iterator[int]:
    """A studio that listens until the end; yields its port."""
    with serve(studio.attend, "127.0.0.1", port) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.socket.getsockname()[1]
        for connection in studio.connections:
            connection.close()
        server.shutdown()
        thread.join()
