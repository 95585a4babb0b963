"""Editing of the landmarks of a take in a viewport: the frame that is shown, enlarged, and what happens to the pins."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender.messages import show_error
from ..blender.timeline import frames_of, seconds_of
from ..blender.viewports import FreeBox, redraw
from ..core.errors import FacemimeError, SourceError
from ..core.files.frame_finder import FrameFinder
from ..core.numeric.arrays import FloatArray
from ..core.takes.pin_editor import PinEditor
from ..core.takes.take import Take
from ..settings import takes_store
from ..settings.takes_properties import FacemimeTake
from ..settings.values import take_start
from .show import TakeShow

_MARGIN = 1.5
"""Width of what is shown at first, relative to that of the face."""
_ZOOMS = (0.1, 64.0)
"""Smallest and largest zoom, pixels of the screen for one of the image."""
_WHOLE = 0.05
"""Frames by which a frame of the scene may differ from one of the take."""
_unedited: dict[str, str] = {}
"""Pins of takes before they were edited in this session, as JSON, by path: Blender's undo knows none of that time."""


class LandmarkEdit:
    """The landmarks of a take, which are edited in a viewport.

    Attributes
    ----------
    scene : int
        `session_uid` of the scene.
    editor : PinEditor
    area : int
        Address of the area in which they are edited.
    held : int or None
        The landmark that is dragged.
    under : int or None
        The landmark under the mouse.
    """

    current: LandmarkEdit | None = None

    def __init__(self, scene: bpy.types.Scene, line: FacemimeTake, area: int) -> None:
        take = takes_store.read(line, solved=False)
        self.scene, self.path, self.area = scene.session_uid, line.path, area
        self.editor = PinEditor(take)
        self.held: int | None = None
        self.under: int | None = None
        self.number = 0
        self._offset = float(take.info.get("offset") or 0.0)
        self._video = line.video
        self._finder = _finder(takes_store.video_of(scene, line))
        self._image: tuple[int, NDArray[np.uint8] | None] = (-1, None)
        self._landmarks: FloatArray | None = None
        self._box = FreeBox(0.0, 0.0, 1.0, 1.0)
        self._zoom, self._middle = 1.0, np.zeros(2)
        self.editor.go_to(seconds_of(scene, take_start(scene)))
        self._at = scene.frame_current_final
        self.show_in_scene(scene)

    def close(self) -> None:
        """Release the video."""
        if self._finder is not None:
            self._finder.close()
        if LandmarkEdit.current is self:
            LandmarkEdit.current = None

    @property
    def has_video(self) -> bool:
        """Whether the video of the take was found."""
        return self._finder is not None

    @property
    def image(self) -> NDArray[np.uint8] | None:
        """The image of the frame, (H, W, 3) BGR; None without a video."""
        if self._finder is None:
            return None
        if self._image[0] != self.editor.frame:
            try:
                image = self._finder.at(self.editor.time + self._offset)
            except SourceError:  # it was moved or deleted meanwhile
                image = None
            self._image = self.editor.frame, image
            self.number += 1
        return self._image[1]

    @property
    def landmarks(self) -> FloatArray:
        """The landmarks of the frame, (66, 2) in pixels of the image."""
        if self._landmarks is None:
            self._landmarks = self.editor.landmarks()
        return self._landmarks

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the images in pixels."""
        width, height = self.editor.take.info.get("image_size", (640, 480))
        return float(width), float(height)

    def changed(self) -> None:
        """Solve the landmarks again, as a pin or the frame has changed."""
        self._landmarks = None

    def look_at(self, box: FreeBox) -> None:
        """Use the part of a region that nothing covers."""
        self._box = box

    def is_inside(self, place: FloatArray) -> bool:
        """Return whether a position (2,) in the region is in that part."""
        box = self._box
        return bool(box.left <= place[0] < box.right and box.bottom <= place[1] < box.top)

    def fit(self) -> None:
        """Show the face, as large as it fits."""
        box = self._box
        points = self.landmarks
        if not np.isfinite(points).all():
            points = np.array([(0.0, 0.0), self.size])
        low, high = points.min(axis=0), points.max(axis=0)
        room = np.array([box.right - box.left, box.top - box.bottom])
        self._middle = 0.5 * (low + high)
        self._set_zoom(float((room / np.maximum(_MARGIN * (high - low), 1.0)).min()))

    def zoom(self, factor: float, at: FloatArray) -> None:
        """Enlarge what is shown by a factor about a position (2,) in the region."""
        there = self.to_image(at)
        self._set_zoom(self._zoom * factor)
        self._middle = self._middle + there - self.to_image(at)

    def _set_zoom(self, zoom: float) -> None:
        self._zoom = float(np.clip(zoom, *_ZOOMS))

    def pan(self, moved: FloatArray) -> None:
        """Move what is shown by pixels (2,) of the region."""
        self._middle = self._middle - moved * (1.0, -1.0) / self._zoom

    def to_region(self, points: FloatArray) -> FloatArray:
        """Convert pixels (..., 2) of the image to pixels of the region."""
        return np.asarray(_middle_of(self._box) + self._zoom * (points - self._middle) * (1.0, -1.0))

    def to_image(self, places: FloatArray) -> FloatArray:
        """Convert pixels (..., 2) of the region to pixels of the image."""
        return np.asarray(self._middle + (places - _middle_of(self._box)) * (1.0, -1.0) / self._zoom)

    def nearest(self, place: FloatArray, reach: float) -> int | None:
        """Return the landmark nearest to a position (2,) in the region, or None if it is farther than `reach`."""
        if not self.editor.found:
            return None
        away = np.linalg.norm(self.to_region(self.landmarks) - place, axis=1)
        closest = int(away.argmin())
        return closest if away[closest] <= reach else None

    def follow_scene(self, scene: bpy.types.Scene) -> bool:
        """Go to the frame that the scene shows, if that has changed, and return whether it has."""
        if self._finder is None:
            self._find_video(scene)
        if scene.session_uid != self.scene or scene.frame_current_final == self._at:
            return False
        self._at = scene.frame_current_final
        self.editor.go_to(seconds_of(scene, take_start(scene)))
        self.changed()
        return True

    def _find_video(self, scene: bpy.types.Scene) -> None:
        """Open the video, if the user has meanwhile said where it is."""
        line = self._line(scene)
        if line is not None and line.video != self._video:
            self._video = line.video
            self._finder = _finder(takes_store.video_of(scene, line))
            self._image = (-1, None)
            redraw(bpy.context)

    def _line(self, scene: bpy.types.Scene) -> FacemimeTake | None:
        """Return the take in the list; None if it was removed."""
        return next((line for line in scene.facemime_takes.items if line.path == self.path), None)

    def show_in_scene(self, scene: bpy.types.Scene) -> None:
        """Let the scene show the frame that is edited."""
        go_to_frame(scene, frame_at(scene, self.editor.time))
        self._at = scene.frame_current_final
        self.changed()

    def save(self, scene: bpy.types.Scene) -> None:
        """Write the pins to the file of the take, and let a preview of it show them; raises FacemimeError."""
        if (line := self._line(scene)) is None:
            raise SourceError("The take was removed from the list. Import it again.")
        write_pins(scene, line, self.editor.take)


def _middle_of(box: FreeBox) -> FloatArray:
    return np.array([0.5 * (box.left + box.right), 0.5 * (box.bottom + box.top)])


def _finder(video: Path | None) -> FrameFinder | None:
    try:
        return None if video is None else FrameFinder(video)
    except SourceError:  # the take can be edited without it
        return None


def frame_at(scene: bpy.types.Scene, time: float) -> float:
    """Return the frame of a scene that shows a time of a take, in seconds."""
    return float(frames_of(scene, np.array([time]), take_start(scene))[0])


def go_to_frame(scene: bpy.types.Scene, frame: float) -> None:
    """Let a scene show a frame, which may be fractional: the whole one if it is as good as that."""
    whole = round(frame)
    if abs(frame - whole) < _WHOLE:
        scene.frame_set(whole)
    else:
        scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))


def write_pins(scene: bpy.types.Scene, line: FacemimeTake, take: Take) -> None:
    """Write the pins of an edited take to its file, and let a preview of it show them.

    Raises FacemimeError if the file cannot be written or read.
    """
    tracked = takes_store.read(line, solved=False)
    before, text = takes_store.pins_json(tracked), takes_store.pins_json(take)
    _unedited.setdefault(line.path, before)
    line.pins = text
    if text == before:
        return
    takes_store.write_pins(line, takes_store.with_pins_of(tracked, text))
    show = TakeShow.running()
    if show is not None and show.path == line.path:
        show.renew(scene, takes_store.read_corrected(scene, line))
    redraw(bpy.context)


def _restore_pins(*_: object) -> None:
    """Write the pins of the undo step that was loaded to the files of their takes."""
    for scene in bpy.data.scenes:
        for line in scene.facemime_takes.items:
            text = line.pins or _unedited.get(line.path, "")
            if text and line.path in _unedited:
                try:
                    tracked = takes_store.read(line, solved=False)
                    write_pins(scene, line, takes_store.with_pins_of(tracked, text))
                except FacemimeError as error:
                    show_error(str(error))


HANDLERS = {"undo_post": _restore_pins, "redo_post": _restore_pins}
