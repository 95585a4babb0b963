"""VTube Studio on a computer, by its WebSocket API, version 1.0 (streams.md).

Facemime asks for permission once, and keeps the token that it receives. The face is then injected as the parameters
that every model of VTube Studio has.
"""

from __future__ import annotations

import json
import logging
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from ..drive.drive_settings import DriveSettings
from ..errors import Message
from ..face.names import COEFFICIENT_INDEX
from ..face.rotation import to_face_axes
from ..files.owner_only import write_secret
from ..files.reading import read_bytes
from ..takes.neutral import Neutral
from ..tracking.result import TrackResult
from .protocols.frames import FaceValues
from .sender import FaceMeasure
from .transport.addresses import LOOPBACK, bracketed, resolve
from .transport.background import Connecting

PORT = 8001
PLUGIN = "Facemime"
DEVELOPER = "Facemime"
_RESEND = 0.5
"""Seconds after which values are sent again, as VTube Studio resets a parameter after one second without any."""
_OPENING = 3.0
"""Seconds for a connection to be established."""
_ASKING = 120.0
"""Seconds for the user to allow the plug-in."""
_ANSWERING = 5.0
"""Seconds for any other answer."""
_AGAIN = 2.0
"""Seconds until the next attempt to connect."""
_LOOK = 0.2
_MAX_ANSWER = 1 << 16
"""Largest size of an answer in bytes."""
_MAX_TOKEN = 1 << 10
"""Largest size of a token in bytes."""
_DENIED = 50
"""Number of the error if the user does not allow the plug-in."""
_ANGLE = 90.0
"""Largest angle of the head that is sent, in degrees."""
_ACROSS = 100.0
"""Units of VTube Studio per metre across and down."""
_DEPTH = 50.0
"""Units of VTube Studio per metre in depth."""
_DEFAULTS = DriveSettings()
_LOG = logging.getLogger(__name__)


class ApiError(Exception):
    """VTube Studio refused a request; `number` is the number of its error."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(text)
        self.number = number


def request(kind: str, data: dict[str, Any]) -> str:
    """Encode a request of the type `kind`, such as "InjectParameterDataRequest", as JSON."""
    message = {"apiName": "VTubeStudioPublicAPI", "apiVersion": "1.0", "requestID": "Facemime", "messageType": kind}
    return json.dumps({**message, "data": data}, separators=(",", ":"))


def parameters(face: FaceValues) -> dict[str, float]:
    """Convert a face to VTube Studio's parameters by name. Angles are in degrees; brows and smile rest at 0.5."""
    value = {name: float(face.coefficients[column]) for name, column in COEFFICIENT_INDEX.items()}
    x, y, z = np.clip(np.degrees(to_face_axes(face.rotation)), -_ANGLE, _ANGLE).tolist()
    across, down, away = (0.0, 0.0, 0.0) if face.position is None else face.position.tolist()
    smile = value["mouthSmileLeft"] + value["mouthSmileRight"] - value["mouthFrownLeft"] - value["mouthFrownRight"]
    left, right = (
        value["browInnerUp"] + value[f"browOuterUp{side}"] - 2.0 * value[f"browDown{side}"]
        for side in ("Left", "Right")
    )
    found = {
        "FaceAngleX": y,
        "FaceAngleY": -x,
        "FaceAngleZ": -z,
        "FacePositionX": _ACROSS * across,
        "FacePositionY": -_ACROSS * down,
        "FacePositionZ": _DEPTH * away,
        "MouthOpen": max(value["jawOpen"] - value["mouthClose"], 0.0),
        "MouthSmile": _within(0.5 + 0.25 * smile),
        "MouthX": value["mouthLeft"] - value["mouthRight"],
        "Brows": _within(0.5 + 0.125 * (left + right)),
        "BrowLeftY": _within(0.5 + 0.25 * left),
        "BrowRightY": _within(0.5 + 0.25 * right),
        "EyeOpenLeft": 1.0 - value["eyeBlinkLeft"],
        "EyeOpenRight": 1.0 - value["eyeBlinkRight"],
        "EyeLeftX": value["eyeLookInLeft"] - value["eyeLookOutLeft"],
        "EyeLeftY": value["eyeLookUpLeft"] - value["eyeLookDownLeft"],
        "EyeRightX": value["eyeLookOutRight"] - value["eyeLookInRight"],
        "EyeRightY": value["eyeLookUpRight"] - value["eyeLookDownRight"],
        "CheekPuff": value["cheekPuff"],
        "TongueOut": value["tongueOut"],
    }
    return {name: round(number, 5) for name, number in found.items()}


def injection(values: dict[str, float], *, found: bool) -> str:
    """Encode the request that sets the values of `parameters`."""
    listed = [{"id": name, "value": number} for name, number in values.items()]
    return request("InjectParameterDataRequest", {"faceFound": found, "mode": "set", "parameterValues": listed})


class VTubeStudioSender(Connecting):
    """Sends tracking results to VTube Studio. See `core.puppet.outputs.Output`.

    Parameters
    ----------
    port : int
        Port; 0 for the usual one.
    token : Path
        File that stores the token.
    options : DriveSettings
        Whether to mirror, and the strength of each region of the face; may be replaced at any time.

    Raises
    ------
    SourceError
        If the host cannot be found.
    """

    def __init__(self, host: str, port: int, token: Path, options: DriveSettings = _DEFAULTS) -> None:
        super().__init__("facemime-vtube-studio", _AGAIN)
        self.options = options
        _, (host, port) = resolve(host or LOOPBACK, port or PORT)
        self._where = f"{bracketed(host)}:{port}"
        self._file = token
        self._measure = FaceMeasure()
        self._values: dict[str, float] = {}
        self._found = self._fresh = False
        self._thread.start()

    def send(
        self, time: float, result: TrackResult, neutral: Neutral | None, size: tuple[int, int] | None = None
    ) -> None:
        """Send a frame. See `Output.send`."""
        face = self._measure.values(result, neutral, self.options)
        with self._news:
            self._values = self._values if face is None else parameters(face)
            self._found, self._fresh = face is not None, True
            self._news.notify()

    def _connect(self) -> None:
        try:
            with connect(
                f"ws://{self._where}",
                open_timeout=_OPENING,
                close_timeout=_LOOK,
                compression=None,
                max_size=_MAX_ANSWER,
                proxy=None,
            ) as connection:
                self._authenticate(connection)
                self.message = ""
                self._feed(connection)
        except ApiError as error:
            self.message = Message("VTube Studio refused: {error}", error=error)
            self._over = self._over or error.number == _DENIED
        except (OSError, WebSocketException, ValueError):
            self.message = _silence(self._where)

    def _authenticate(self, connection: ClientConnection) -> None:
        """Authenticate with the stored token; request a new one if it is missing or no longer valid."""
        plugin = {"pluginName": PLUGIN, "pluginDeveloper": DEVELOPER}
        token = self._kept()
        for _ in range(2):
            if not token:
                self.message = Message("VTube Studio is asking for permission. Click Allow there.")
                answer = self._ask(connection, "AuthenticationToken", plugin, _ASKING)
                token = str(answer.get("authenticationToken", ""))[:_MAX_TOKEN]
                self._keep(token)
            shown = {**plugin, "authenticationToken": token}
            if self._ask(connection, "Authentication", shown, _ANSWERING).get("authenticated") is True:
                return
            token = ""
        raise ApiError(0, Message("it rejected the token it had just issued. Restart VTube Studio."))

    def _ask(self, connection: ClientConnection, kind: str, data: dict[str, Any], patience: float) -> dict[str, Any]:
        """Send a request, and return the answer."""
        connection.send(request(f"{kind}Request", data))
        end = monotonic() + patience
        while not self._over and monotonic() < end:
            try:
                answer = _checked(connection.recv(_LOOK))
            except TimeoutError:
                continue
            if answer.get("messageType") == f"{kind}Response":
                content = answer.get("data")
                return content if isinstance(content, dict) else {}
        raise TimeoutError

    def _feed(self, connection: ClientConnection) -> None:
        """Send new values as they come, or else repeat the last ones."""
        while True:
            with self._news:
                self._news.wait_for(lambda: self._over or self._fresh, _RESEND)
                if self._over:
                    return
                message = injection(self._values, found=self._found) if self._values else ""
                self.sent += self._fresh and bool(message)
                self._fresh = False
            if message:
                connection.send(message)
            self._answers(connection)

    def _answers(self, connection: ClientConnection) -> None:
        try:
            while True:
                _checked(connection.recv(0))
        except TimeoutError:
            return

    def _kept(self) -> str:
        try:
            return read_bytes(self._file, _MAX_TOKEN).decode("ascii").strip()
        except (OSError, ValueError):
            return ""

    def _keep(self, token: str) -> None:
        """Store the token for the next session; if that fails, VTube Studio asks the user again."""
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            write_secret(self._file, token.encode("ascii") + b"\n", replace=True)
        except (OSError, ValueError):
            _LOG.warning("The token of VTube Studio cannot be kept in %s", self._file)


def _checked(data: str | bytes) -> dict[str, Any]:
    """Parse an answer; ApiError if it is an error, ValueError if it is not an answer."""
    answer = json.loads(data)
    if not isinstance(answer, dict):
        raise ValueError("not an answer")
    if answer.get("messageType") == "APIError":
        content = answer.get("data")
        content = content if isinstance(content, dict) else {}
        number, text = content.get("errorID"), content.get("message")
        raise ApiError(number if isinstance(number, int) else 0, str(text)[:200])
    return answer


def _silence(where: str) -> str:
    return Message(
        "VTube Studio does not answer at {where}. Enable Allow Plugin API access in its settings.", where=where
    )


def _within(number: float) -> float:
    return min(max(number, 0.0), 1.0)
