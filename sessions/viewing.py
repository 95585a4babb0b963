"""Other places where a live session shows its heads: browsers, and other programs that receive moved vertices."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import bpy

from ..blender.animation.appearance import read_appearance
from ..blender.messages import show_error
from ..core.errors import FacemimeError
from ..core.heads.appearance import Appearance
from ..core.live.worker import LiveWorker
from ..core.streams.transport.addresses import LOOPBACK
from ..core.streams.vertices import VertexSender
from ..core.viewer.viewer_settings import new_token
from ..settings.properties import FacemimeSettings
from ..settings.stream_properties import FacemimeOutput
from ..settings.values import sends_vertices, viewer_settings

if TYPE_CHECKING:
    from ..core.viewer.server import ViewerServer
    from .live import LiveSession


@lru_cache(maxsize=1)
def token() -> str:
    """Return the secret in the address, which stays the same until Blender quits, so that open pages reconnect."""
    return new_token()


def open_viewer(settings: FacemimeSettings, objects: Sequence[bpy.types.Object | None]) -> ViewerServer | None:
    """Start the server if it is enabled.

    Parameters
    ----------
    objects : sequence of bpy.types.Object or None
        The heads, in the order of the session; None for one that was deleted.

    Raises
    ------
    FacemimeError
        If it cannot be started, or other computers may connect and Blender's online access is turned off.
    """
    wanted = viewer_settings(settings.viewer, token())
    if wanted is None:
        return None
    from ..core.viewer.server import ViewerServer  # only now, as its libraries take a tenth of a second

    looks = [Appearance("", ()) if obj is None else read_appearance(obj) for obj in objects]
    server = ViewerServer(wanted, looks)
    server.follow = (settings.rotation, settings.translation)
    return server


def open_vertices(output: FacemimeOutput, objects: Sequence[bpy.types.Object]) -> VertexSender | None:
    """Start sending the moved vertices if this is enabled.

    Parameters
    ----------
    objects : sequence of bpy.types.Object
        The heads, in the order of the session.

    Raises
    ------
    FacemimeError
        If the receiver is not known, or is another computer and Blender's online access is turned off.
    """
    if not sends_vertices(output):
        return None
    return VertexSender(output.host.strip() or LOOPBACK, output.port, [read_appearance(obj) for obj in objects])


class Displays:
    """The browsers and programs that show the heads of a session, besides its viewports."""

    def __init__(self, worker: LiveWorker) -> None:
        self._worker = worker
        self._viewer: ViewerServer | None = None
        self._vertices: VertexSender | None = None

    @property
    def viewer(self) -> ViewerServer | None:
        """The server that shows the heads in browsers, if enabled."""
        return self._viewer

    @property
    def vertices(self) -> VertexSender | None:
        """The sender of the moved vertices, if enabled."""
        return self._vertices

    def view(self, viewer: ViewerServer | None) -> None:
        """Replace the viewer, and end the previous one."""
        before, self._viewer = self._viewer, viewer
        self._replace(before)

    def send_vertices(self, sender: VertexSender | None) -> None:
        """Replace the sender of the moved vertices, and end the previous one."""
        before, self._vertices = self._vertices, sender
        self._replace(before)

    def close(self) -> None:
        """End the viewer and the sender."""
        self.view(None)
        self.send_vertices(None)

    def _replace(self, before: ViewerServer | VertexSender | None) -> None:
        self._worker.displays = tuple(one for one in (self._viewer, self._vertices) if one is not None)
        if before is not None:
            before.close()


def follow_viewer(session: LiveSession, settings: FacemimeSettings) -> None:
    """Start or stop the server of a running session if the settings ask for it.

    An error is shown, and switches the viewer off rather than ending the puppet.
    """
    server = session.displays.viewer
    if server is not None and server.follow != (follow := (settings.rotation, settings.translation)):
        server.follow = follow
    try:
        wanted = viewer_settings(settings.viewer, token())
        if wanted == (None if server is None else server.settings):
            return
        session.displays.view(None)
        session.displays.view(open_viewer(settings, [None if shown.gone else shown.obj for shown in session.heads]))
    except FacemimeError as error:
        settings.viewer.enabled = False
        show_error(str(error))
