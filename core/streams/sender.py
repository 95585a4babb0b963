"""A sender, which passes the results of a session to another computer or program, frame by frame."""

from __future__ import annotations

import socket
from contextlib import suppress
from time import perf_counter

import numpy as np

from ..bake.arkit import FrameCoefficients
from ..drive.drive_settings import DriveSettings
from ..errors import SourceError
from ..face.rotation import euler_to_matrix, matrix_to_euler
from ..heads.built_in import eyes_of_gaze
from ..numeric.arrays import FloatArray
from ..takes.measured import IMAGE_SIZE, coefficient_face
from ..takes.neutral import MIRROR_WIDTH, Neutral
from ..tracking.result import CAMERA_DISTANCE, TrackResult, mirror_result
from .casting import Address
from .protocols import live_link, openseeface, vmc
from .protocols.frames import MAX_DATAGRAM, FaceValues, PacketError
from .stream_settings import EXPRESSIONS, OWN, PROTOCOLS, SendSettings
from .transport import datagram
from .transport.addresses import cannot_send, nobody_receives, resolve
from .transport.datagram import OwnSender
from .transport.security import read_key

SENT = (OWN, "livelink", "vmc", "openseeface")
"""Names of the protocols that can be sent."""
VTUBE_STUDIO = "vtubestudio"
"""Name of the protocol sent by `vtube_studio_api`, which needs a library."""
_HELLO_EVERY = (0.25, 1.0)
"""Seconds between handshakes, before and after the receiver has answered."""
_MAX_ANSWERS = 64
"""Most answers that are read before a frame is sent."""
_ANSWER = 2.0
"""Seconds without the answer that nobody receives after which somebody does; some computers answer once per second."""
_DEFAULTS = DriveSettings()
_DEVICE = "00000000-0000-4000-8000-666163656d65"


class FaceMeasure:
    """Measures faces as values, for protocols that transmit these."""

    def __init__(self) -> None:
        self._neutral: Neutral | None = None
        self._made_for: tuple[int, DriveSettings] | None = None
        self._coefficients: FrameCoefficients | None = None

    def values(self, result: TrackResult, neutral: Neutral | None, options: DriveSettings) -> FaceValues | None:
        """Measure a face relative to the performer's neutral face, which is not mirrored; None if either is missing.

        `options` tell whether to mirror, and the strength of each region of the face.
        """
        if neutral is None or not result.found:
            return None
        if self._coefficients is None or self._made_for != (id(neutral), options):
            self._neutral, self._made_for = neutral, (id(neutral), options)
            self._coefficients = FrameCoefficients(neutral, options)
        seen = mirror_result(result, MIRROR_WIDTH) if options.mirror else result
        own = neutral.mirrored() if options.mirror else neutral
        eyes = eyes_from(seen, own)
        return FaceValues(self._coefficients.of(result), turned_from(seen, own), moved_from(seen, own), eyes)


class StreamSender:
    """Sends tracking results, whether or not a receiver listens yet.

    Parameters
    ----------
    options : DriveSettings
        Whether to mirror, and the strength of each region of the face. Facemime's own protocol leaves both to the
        receiver. May be replaced at any time.

    Attributes
    ----------
    sent : int
        Number of frames sent.
    message : str
        Reason why nothing is sent; otherwise "".

    Raises
    ------
    SourceError
        If the settings cannot be used, the host cannot be found, or the key cannot be read.
    """

    def __init__(self, settings: SendSettings, options: DriveSettings = _DEFAULTS) -> None:
        if settings.protocol not in SENT:
            raise SourceError(
                "There is no protocol {protocol!r} to send. Use one of {known}.",
                protocol=settings.protocol,
                known=", ".join(SENT),
            )
        if settings.expressions not in EXPRESSIONS:
            raise SourceError(
                "There are no expressions {expressions!r}. Use one of {known}.",
                expressions=settings.expressions,
                known=", ".join(EXPRESSIONS),
            )
        if settings.protocol == OWN and settings.key is None and not settings.is_local:
            raise SourceError("A stream to another computer needs a shared key. Choose its file under Key.")
        self.settings, self.options = settings, options
        self.sent, self.message = 0, ""
        self._family, self._address = resolve(settings.host, settings.port or PROTOCOLS[settings.protocol].port)
        self._own = OwnSender(None if settings.key is None else read_key(settings.key))
        # The receiver of VMC may answer from any port, which a connected socket would not receive.
        self._listens = settings.protocol == "vmc" and settings.expressions == "automatic"
        self._socket, self._prober = self._opened(), self._opened()
        self._absent = self._probed = -np.inf
        self._greeted = -np.inf
        self._face = FaceMeasure()
        self._arkit = settings.expressions == "arkit"

    def send(
        self, time: float, result: TrackResult, neutral: Neutral | None, size: tuple[int, int] | None = None
    ) -> None:
        """Send a frame.

        Parameters
        ----------
        time : float
            Time of the media in seconds.
        neutral : Neutral or None
            The performer's neutral face, not mirrored. Without one, only Facemime's own protocol and OpenSeeFace send.
        size : (int, int), optional
            Width and height of the image in pixels; by default those of the image of faces that are not tracked.
        """
        if self.settings.protocol == OWN:
            self._greet()
            if not self._own.ready:
                return
        try:
            packets = self._packets(max(time, 0.0), result, neutral, size or IMAGE_SIZE)
            for packet in packets:
                self._put(packet)
            self._probe(packets)
        except ConnectionError:
            self._miss()
            return
        except BlockingIOError:
            return  # the network is busy; the next frame will do
        except OSError as error:
            self.message = str(cannot_send(*self._address, error))
            self.close()  # the computer may have moved to another network
            self._socket, self._prober = self._opened(), self._opened()
            return
        self.sent += bool(packets)
        if perf_counter() - self._absent > _ANSWER:
            self.message = ""

    def close(self) -> None:
        """Close the sockets. May be called twice."""
        self._socket.close()
        self._prober.close()

    def _packets(self, time: float, result: TrackResult, neutral: Neutral | None, size: tuple[int, int]) -> list[bytes]:
        protocol = self.settings.protocol
        if protocol == OWN:
            return [self._own.packet(*datagram.encode_face(result), time)]
        if protocol == "openseeface":
            if not result.found:
                return []
            rest = None if neutral is None else (neutral.mirrored() if self.options.mirror else neutral).shape
            seen = mirror_result(result, size[0]) if self.options.mirror else result
            return [openseeface.encode(seen, time, size, rest)]
        face = self._face.values(result, neutral, self.options)
        if face is None and (result.found or neutral is None):
            return []
        if protocol == "vmc":
            return list(vmc.encode(face, time, self._expressions()))
        return [live_link.encode(face, time, subject=self.settings.subject, device=_DEVICE)]

    def _expressions(self) -> vmc.Names:
        """Return the names of the expressions to send: if they are not chosen, those that the receiver answers with."""
        if self.settings.expressions == "automatic" and not self._arkit:
            with suppress(BlockingIOError):
                for _ in range(_MAX_ANSWERS):
                    data, address = self._socket.recvfrom(MAX_DATAGRAM)
                    self._arkit = self._arkit or (address[0] == self._address[0] and vmc.has_arkit_names(data))
        return "arkit" if self._arkit else "vrm"

    def _opened(self) -> socket.socket:
        opened = socket.socket(self._family, socket.SOCK_DGRAM)
        opened.setblocking(False)
        return opened

    def _miss(self) -> None:
        """Note that nobody receives."""
        self._absent, self.message = perf_counter(), nobody_receives(*self._address)

    def _put(self, packet: bytes) -> None:
        """Send a packet; ConnectionError if the computer has answered that nobody receives the one before."""
        if self._listens:
            self._socket.sendto(packet, self._address)
        else:
            _send_connected(self._socket, packet, self._address)

    def _probe(self, packets: list[bytes]) -> None:
        """Repeat a packet now and then on a connected socket, if the others are sent on one that is not."""
        now = perf_counter()
        if not self._listens or not packets or now - self._probed < 0.5 * _ANSWER:
            return
        self._probed = now
        try:
            _send_connected(self._prober, packets[0], self._address)
        except ConnectionError:
            self._prober.send(packets[0])
            raise

    def _greet(self) -> None:
        """Keep up the handshake, if there is a key."""
        now = perf_counter()
        try:
            with suppress(BlockingIOError, PacketError):
                while True:
                    self._own.answer(self._socket.recv(512))
        except ConnectionError:
            self._miss()
        except OSError:  # some systems cannot receive before anything was sent
            pass
        if now - self._greeted >= _HELLO_EVERY[self._own.ready] and (hello := self._own.hello()):
            self._greeted = now
            try:
                self._put(hello)
            except ConnectionError:
                self._miss()
            except OSError as error:
                self.message = str(cannot_send(*self._address, error))


def _send_connected(sender: socket.socket, packet: bytes, address: Address) -> None:
    """Send a packet on a connected socket, as only that one reports that nobody receives."""
    try:
        sender.getpeername()
    except OSError:
        sender.connect(address)
    sender.send(packet)


def turned_from(result: TrackResult, neutral: Neutral) -> FloatArray:
    """Compute the rotation of a tracked head from the neutral one: pitch, yaw and roll (3,) in radians."""
    return np.array(matrix_to_euler(euler_to_matrix(*result.pose[1:4]) @ neutral.rotation.T))


def eyes_from(result: TrackResult, neutral: Neutral) -> FloatArray | None:
    """Compute the directions of the eyes relative to those of a neutral face; None if the gaze is unknown.

    These are the `(pitch, yaw)` of the right and the left eye in radians, (2, 2).
    """
    gaze = result.gaze - neutral.gaze
    return (
        eyes_of_gaze(gaze, float(np.nan_to_num(result.vergence - neutral.vergence)))
        if np.isfinite(gaze).all()
        else None
    )


def moved_from(result: TrackResult, neutral: Neutral) -> FloatArray:
    """Compute the translation (3,) of a tracked head from the neutral one, in metres along the head frame's axes.

    Equation 4.4, for a head of the size of the built-in one.
    """
    scale, x, y = neutral.position
    size = float(result.pose[0])
    across, down = (result.pose[4:] - (x, y)) / np.sqrt(size * scale)
    return coefficient_face().unit * np.array([across, down, CAMERA_DISTANCE * (scale / size - 1.0)])
