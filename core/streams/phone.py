"""A phone that sends only on request, and only as long as it is told that the receiver listens."""

from __future__ import annotations

import numpy as np

from .casting import Address
from .links import Link
from .protocols.face_motion import MAGIC, FaceMotionReceiver
from .stream_settings import PROTOCOLS, StreamSettings
from .transport.addresses import resolve

_ASK_AGAIN = 2.0
"""Seconds after which a phone is asked again."""
_ASK_OTHERWISE = 1.0
"""Seconds after which a phone that has not answered is asked for its other protocol."""


class Phone:
    """Makes the packets for a phone. An app that may support `face_motion` is asked for it and for text alternately.

    Parameters
    ----------
    settings : StreamSettings
        Settings; without the address of a phone, nothing is sent.
    """

    def __init__(self, settings: StreamSettings) -> None:
        self._protocol = PROTOCOLS[settings.protocol]
        self._host = settings.phone
        self._address: Address | None = None
        self._motion = FaceMotionReceiver(connected=self._protocol.connected) if self._protocol.motion_port else None
        self._motion_phone: Address = ("", 0)
        self._motion_address = self._motion_phone
        self._asked, self._requests = -np.inf, 0

    @property
    def message(self) -> str:
        """Reason why the phone refuses to send; otherwise ""."""
        return "" if self._motion is None else self._motion.message

    def find(self) -> None:
        """Look up the address of the phone, once; SourceError if its name is unknown."""
        if self._host and self._address is None:
            _, self._address = resolve(self._host, self._protocol.phone_port)
            self._motion_phone = self._motion_address = self._address[0], self._protocol.motion_port

    def may_send(self, address: Address) -> bool:
        """Return whether packets from `address` are accepted: only the phone's, if its address is known."""
        return self._address is None or address[0] == self._address[0]

    def receiver(self, data: bytes, address: Address) -> FaceMotionReceiver | None:
        """Return the receiver for a packet of `face_motion`.

        Parameters
        ----------
        address : (str, int)
            Its sender, which later packets are sent to.

        Returns
        -------
        FaceMotionReceiver or None
            The receiver; None if `data` belongs to another protocol.
        """
        if self._motion is None or not data.startswith(MAGIC):
            return None
        self._motion_address = address
        return self._motion

    def due(self, now: float, link: Link, *, heard: bool) -> list[tuple[bytes, Address]]:
        """Return the packets that the phone needs now, and their addresses.

        Parameters
        ----------
        now : float
            Time in seconds on any clock.
        link : Link
            Link to the phone.

        Returns
        -------
        list of (bytes, (str, int))
            Packets and addresses.
        """
        if self._motion is not None and link.is_lost(self._motion_address):
            self._motion.end()
            self._motion_address = self._motion_phone
        packets = [] if self._motion is None else [(data, self._motion_address) for data in self._motion.due(now)]
        if self._address is None or now - self._asked < (_ASK_AGAIN if self._motion is None else _ASK_OTHERWISE):
            return packets
        self._asked = now
        sends = heard or (self._motion is not None and self._motion.active(now))
        if self._protocol.leased or not sends:
            packets.append(self._request(link.address[1]))
        return packets

    def farewell(self) -> list[tuple[bytes, Address]]:
        """Return the packets that end the session, and their addresses."""
        packets = [] if self._motion is None else [(data, self._motion_address) for data in self._motion.stop()]
        if not packets and self._protocol.stop and self._address is not None:
            packets.append((self._protocol.stop, self._address))
        return packets

    def _request(self, port: int) -> tuple[bytes, Address]:
        """Ask for the newest protocol first, as the app would end it if asked for the older one."""
        assert self._address is not None
        self._requests += 1
        if self._motion is not None and self._requests % 2:
            return self._motion.hello(), self._motion_address
        return self._protocol.request(port), self._address
