"""Settings of streams: protocol, source and playout of received ones, and where they are sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import Message, SourceError
from ..files.setting import Choice, setting, settings_of
from . import vertices
from .protocols import face_cap, face_motion, ifacialmocap, live_link, openseeface, vmc, vrcfacetracking, vtube_studio
from .protocols.frames import Decoder
from .protocols.live_link import ANGLES, Angles
from .transport import datagram
from .transport.addresses import EVERYWHERE, LOOPBACK, Pairing, is_loopback
from .transport.security import read_key
from .vertices import VERTICES

OWN = "own"
_MIN_DELAY = 0.0
_MAX_DELAY = 2.0
"""Largest delay in seconds."""
AXES = ("pitch", "yaw", "roll")


@dataclass(frozen=True)
class StreamProtocol:
    """A protocol that can be received.

    Attributes
    ----------
    label : str
        Its name in the interface.
    port : int
        Default port on which it is received.
    decoder : callable or None
        Creates a decoder for a sender from the settings; None for Facemime's own protocol.
    phone_port : int
        Port at which the phone has to be asked to send; 0 if it sends by itself.
    request : callable
        Creates that request, for the port on which the answer is received.
    motion_port : int
        Port at which the phone is asked for `face_motion` first; 0 if it does not support it.
    leased : bool
        Whether the request has to be repeated while the phone sends.
    connected : bool
        Whether senders connect over TCP; otherwise they send datagrams.
    end : bytes
        What each text over TCP ends with; b"" if messages follow their length.
    stop : bytes
        Datagram that asks the phone to end; b"" for none.
    description : str
        Its tooltip: what sends it.
    number : int
        Number that a .blend file stores; -1 for its place in `PROTOCOLS`.
    """

    label: str
    port: int
    decoder: Callable[[StreamSettings], Decoder] | None
    phone_port: int = 0
    request: Callable[[int], bytes] = lambda port: b""
    motion_port: int = 0
    leased: bool = False
    connected: bool = False
    end: bytes = b""
    stop: bytes = b""
    description: str = ""
    number: int = -1


@dataclass(frozen=True)
class StreamSettings:
    """Source of a stream, and how it is played.

    Attributes
    ----------
    protocol : str
        One of `PROTOCOLS`.
    host : str
        Address of this computer on which packets are received; only this computer can send to a loopback address.
    port : int
        Port; 0 for the usual one.
    phone : str
        Address of the phone, for protocols in which it has to be asked.
    key : Path or None
        File with the shared key of Facemime's own protocol.
    delay : float
        Delay in seconds, which lets late packets arrive in time.
    sender : str
        Address or name of the sender to follow; "" for the first one that comes.
    angles : {"radians", "degrees", "half-turns"}
        Unit of the angles of Live Link Face.
    flip : tuple of {"pitch", "yaw", "roll"}
        Rotations of the head to reverse.
    swap : bool
        Whether left and right of the face are exchanged.
    senders : tuple of str
        For each head, the address or name of the sender that drives it; "" for `sender`.
    pairing : Pairing or None
        The sender of Facemime's own protocol to connect to over TLS, instead of listening.
    """

    protocol: str = OWN
    host: str = LOOPBACK
    port: int = 0
    phone: str = ""
    key: Path | None = None
    delay: float = setting(
        0.02,
        "Delay",
        "Delay that compensates for packets arriving at uneven intervals",
        low=0.0,
        high=2.0,
        soft_high=0.2,
        unit="seconds",
    )
    sender: str = ""
    angles: Angles = setting(
        "radians",
        "Angles",
        "Unit of the head's angles, which differs between senders of Live Link Face's protocol",
        choices=(
            Choice("radians", "Radians", "As Live Link Face sends them"),
            Choice("degrees", "Degrees", "As some other programs send them"),
            Choice(
                "half-turns",
                "Half Turns",
                "Fractions of 180 degrees, as programs modelled on Unreal's plug-in send them",
            ),
        ),
    )
    flip: tuple[str, ...] = ()
    swap: bool = setting(
        False,
        "Swap Left and Right",
        "Exchange left and right of the face, for senders that mirror it; the head's rotation is left to Flip",
    )
    senders: tuple[str, ...] = ("",)
    pairing: Pairing | None = None

    @property
    def label(self) -> str:
        """Name of the source in the interface."""
        label = PROTOCOLS[self.protocol].label
        return f"{label} on port {self.port}" if self.pairing is None else f"{label} at {self.pairing.address}"

    @property
    def is_local(self) -> bool:
        """Whether the stream does not involve other computers."""
        if self.pairing is not None:
            return self.pairing.is_local
        return is_loopback(self.host) and (not self.phone or is_loopback(self.phone))

    def checked(self) -> StreamSettings:
        """Return the settings with definite port and address; SourceError if they cannot be used."""
        if self.protocol not in PROTOCOLS:
            raise SourceError(
                "There is no protocol {protocol!r}. Use one of {known}.",
                protocol=self.protocol,
                known=", ".join(PROTOCOLS),
            )
        protocol = PROTOCOLS[self.protocol]
        if not 0 <= self.port <= 65535:
            raise SourceError(
                "There is no port {port}. Use one between 1 and 65535, or 0 for the usual one.", port=self.port
            )
        if not _MIN_DELAY <= self.delay <= _MAX_DELAY:
            raise SourceError(
                "The delay must be between 0 and {max_delay:g} s; got {delay:g}.",
                max_delay=_MAX_DELAY,
                delay=self.delay,
            )
        if self.angles not in ANGLES or set(self.flip) - set(AXES):
            raise SourceError(
                "Angles must be radians, degrees or half-turns, and only pitch, yaw and roll can be flipped."
            )
        if protocol.phone_port and not self.phone:
            raise SourceError(
                "{label} needs the address of the phone. Enter the one that the app shows.",
                label=Message(protocol.label),
            )
        if self.pairing is not None and self.protocol != OWN:
            raise SourceError("Pairing works only with Facemime's own protocol. Choose Facemime as the protocol.")
        if self.protocol == OWN and self.pairing is None and self.key is None and not self.is_local:
            raise SourceError("A stream from another computer needs a shared key. Choose its file under Key.")
        host = self.host
        if protocol.phone_port and not is_loopback(self.phone) and is_loopback(host):
            host = EVERYWHERE
        return StreamSettings(**{**self.__dict__, "host": host, "port": self.port or protocol.port})

    def secret(self) -> bytes | None:
        """Read the shared key, if there is one; SourceError if it cannot be read."""
        return None if self.key is None or self.pairing is not None else read_key(self.key)


@dataclass(frozen=True)
class SendSettings:
    """Destination of a stream.

    Attributes
    ----------
    protocol : str
        One of `sender.SENT`.
    port : int
        Port; 0 for the usual one.
    key : Path or None
        File with the shared key of Facemime's own protocol.
    subject : str
        Name under which Live Link Face shows the face.
    expressions : {"automatic", "arkit", "vrm"}
        Names of the expressions that VMC sends.
    """

    protocol: str = OWN
    host: str = LOOPBACK
    port: int = 0
    key: Path | None = None
    subject: str = "Facemime"
    expressions: str = setting(
        "automatic",
        "Expressions",
        "Names of the expressions that move; the others are sent as 0, so that no avatar moves twice as far",
        choices=(
            Choice(
                "automatic",
                "Automatic",
                "ARKit's names if the receiver answers that its avatar has them, and otherwise VRM's",
            ),
            Choice("arkit", "ARKit Names", "For avatars made for perfect sync, and programs that know ARKit's names"),
            Choice("vrm", "VRM Expressions", "For all other VRM avatars"),
        ),
    )

    @property
    def is_local(self) -> bool:
        """Whether nothing leaves this computer."""
        return is_loopback(self.host)


EXPRESSIONS = settings_of(SendSettings)["expressions"].values
"""Values of `SendSettings.expressions`."""


PROTOCOLS: dict[str, StreamProtocol] = {
    OWN: StreamProtocol("Facemime", datagram.PORT, None, description="Another computer with Facemime"),
    "livelink": StreamProtocol(
        "Live Link Face",
        live_link.PORT,
        lambda s: live_link.LiveLinkDecoder(s.angles),
        description="Epic's iPhone app in ARKit mode, or Unreal Engine",
    ),
    "vmc": StreamProtocol(
        "VMC",
        vmc.PORT,
        lambda s: vmc.VmcDecoder(),
        description="VTuber programs that use the VMC protocol",
    ),
    "openseeface": StreamProtocol(
        "OpenSeeFace",
        openseeface.PORT,
        lambda s: openseeface.OpenSeeFaceDecoder(),
        description="OpenSeeFace's tracker, or VTuber programs that receive from it",
    ),
    "ifacialmocap": StreamProtocol(
        "iFacialMocap",
        ifacialmocap.PORT,
        lambda s: ifacialmocap.IFacialMocapDecoder(),
        ifacialmocap.PHONE_PORT,
        lambda port: ifacialmocap.START,
        face_motion.PHONE_PORT,
        description="The app iFacialMocap on an iPhone",
    ),
    "facemotion3d": StreamProtocol(
        "Facemotion3d",
        ifacialmocap.PORT,
        lambda s: ifacialmocap.IFacialMocapDecoder(),
        ifacialmocap.FACEMOTION_PORT,
        lambda port: ifacialmocap.FACEMOTION_START,
        face_motion.PHONE_PORT,
        stop=ifacialmocap.FACEMOTION_STOP,
        description="The app Facemotion3d on a phone",
    ),
    "vtubestudio": StreamProtocol(
        "VTube Studio, MeowFace",
        vtube_studio.PORT,
        lambda s: vtube_studio.VTubeStudioDecoder(),
        vtube_studio.PORT,
        vtube_studio.request,
        leased=True,
        description="VTube Studio on an iPhone, or MeowFace on Android",
    ),
    "facecap": StreamProtocol(
        "Face Cap",
        face_cap.PORT,
        lambda s: face_cap.FaceCapDecoder(),
        description="The app Face Cap on an iPhone",
    ),
    VERTICES: StreamProtocol(
        "Vertices",
        vertices.PORT,
        lambda s: vertices.VertexDecoder(),
        connected=True,
        description="Moved vertices from another Facemime or an engine over TCP",
    ),
    "ifacialmocap-tcp": StreamProtocol(
        "iFacialMocap over TCP",
        ifacialmocap.TCP_PORT,
        lambda s: ifacialmocap.IFacialMocapDecoder(),
        ifacialmocap.PHONE_PORT,
        lambda port: ifacialmocap.TCP_START,
        face_motion.TCP_PORT,
        connected=True,
        end=ifacialmocap.TCP_END,
        stop=ifacialmocap.TCP_STOP,
        description="The app iFacialMocap, in networks that lose packets",
    ),
    "vrcfacetracking": StreamProtocol(
        "VRCFaceTracking",
        vrcfacetracking.PORT,
        lambda s: vrcfacetracking.VrcFaceTrackingDecoder(),
        description="VRCFaceTracking, for headsets that track the face",
        number=11,
    ),
    "facemotion3d-tcp": StreamProtocol(
        "Facemotion3d over TCP",
        ifacialmocap.TCP_PORT,
        lambda s: ifacialmocap.IFacialMocapDecoder(),
        ifacialmocap.FACEMOTION_PORT,
        lambda port: ifacialmocap.FACEMOTION_TCP_START,
        face_motion.TCP_PORT,
        connected=True,
        end=ifacialmocap.FACEMOTION_TCP_END,
        stop=ifacialmocap.FACEMOTION_STOP,
        description="The app Facemotion3d, in networks that lose packets",
        number=10,
    ),
}
"""Protocols that can be received, by the name that commands and files use, in the order of the menu."""
