"""Performers and their calibrations, which are the shapes of their faces.

They are remembered until Blender quits, and stored in the .blend file only if the user asks for it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from uuid import uuid4

import bpy

from ..core.errors import FacemimeError
from ..core.takes.learnt import Learnt, learnt_from_json, learnt_to_json
from ..core.takes.neutral import Neutral
from .properties import FacemimePerformer, FacemimeSettings

_session: dict[tuple[str, str], str] = {}
"""What is known of performers in this session, as JSON, by their keys and the names of their properties."""
_KNOWN = ("calibration", "learnt")
"""Properties that describe a performer's face."""


def calibration_of(performer: FacemimePerformer) -> str:
    """Return the JSON of a performer's calibration, from this session or otherwise from the file, or ""."""
    return _known(performer, "calibration")


def _known(performer: FacemimePerformer, name: str) -> str:
    return _session.get((performer.key, name)) or str(getattr(performer, name))


def read_calibration(settings: FacemimeSettings) -> Neutral | None:
    """Return the calibration of the selected performer, or None if that performer has not been calibrated.

    Raises SourceError if the stored calibration is damaged.
    """
    performer = selected_performer(settings)
    text = "" if performer is None else calibration_of(performer)
    return Neutral.from_json(text) if text else None


def selected_performer(settings: FacemimeSettings) -> FacemimePerformer | None:
    """Return the selected performer, or None."""
    known = 0 <= settings.performer < len(settings.performers)
    return settings.performers[settings.performer] if known else None


def write_calibration(settings: FacemimeSettings, neutral: Neutral) -> str:
    """Remember `neutral` for the selected performer, or a new one, and return the performer's name.

    It is stored in the .blend file only if the user has asked for that.
    """
    return _remember(settings, "calibration", json.dumps(neutral.to_dict()))


def _remember(settings: FacemimeSettings, name: str, text: str) -> str:
    """Remember what is known of the selected performer, or of a new one, and return the performer's name."""
    if selected_performer(settings) is None:
        add_performer(settings)
    performer = settings.performers[settings.performer]
    if not performer.key or _is_shared(performer):
        _give_key(performer)
    _session[performer.key, name] = text
    setattr(performer, name, text if settings.keep_calibrations else "")
    return str(performer.name)


def _is_shared(performer: FacemimePerformer) -> bool:
    """Return whether another performer of the file has the same key, as after a scene was copied."""
    return [other.key for other in _everybody()].count(performer.key) > 1


def _give_key(performer: FacemimePerformer) -> None:
    """Give a performer a key of its own, with what is known already."""
    known = {name: _known(performer, name) for name in _KNOWN}
    performer.key = uuid4().hex
    _session.update({(performer.key, name): text for name, text in known.items() if text})


def _everybody() -> list[FacemimePerformer]:
    """Return the performers of all scenes of the file."""
    scenes = [scene for scene in bpy.data.scenes if scene.library is None]
    return [performer for scene in scenes for performer in scene.facemime.performers]


def write_learnt(settings: FacemimeSettings, learnt: Sequence[Learnt]) -> str:
    """Remember what was learnt from pins for the selected performer, or a new one, and return the performer's name.

    It is stored in the .blend file only if the user has asked for that.
    """
    return _remember(settings, "learnt", learnt_to_json(learnt))


def read_learnt(settings: FacemimeSettings) -> tuple[Learnt, ...]:
    """Return what was learnt from pins about the selected performer; raises SourceError if that is damaged."""
    performer = selected_performer(settings)
    text = "" if performer is None else _known(performer, "learnt")
    return learnt_from_json(text) if text else ()


def add_performer(settings: FacemimeSettings, name: str = "") -> None:
    """Add a performer and select it; without a `name` it is numbered."""
    taken = {performer.name for performer in settings.performers}
    performer = settings.performers.add()
    number = len(settings.performers)
    performer.name = name or next(f"Performer {n}" for n in range(number, number + 99) if f"Performer {n}" not in taken)
    settings.performer = len(settings.performers) - 1


def remove_performer(settings: FacemimeSettings) -> None:
    """Remove the selected performer; raises FacemimeError if there is none."""
    if not 0 <= settings.performer < len(settings.performers):
        raise FacemimeError("No performer is selected. Select one in the list.")
    settings.performers.remove(settings.performer)
    settings.performer = min(settings.performer, len(settings.performers) - 1)


def forget(performer: FacemimePerformer) -> None:
    """Remove what is known of a performer from the session and the file."""
    for name in _KNOWN:
        _session.pop((performer.key, name), None)
        setattr(performer, name, "")


def _before_saving(filepath: str, *_: object) -> None:
    if bpy.data.filepath and filepath != bpy.data.filepath:  # what is learnt in one file is not for its copy as well
        for performer in _everybody():
            if performer.key:
                _give_key(performer)
    for scene in bpy.data.scenes:
        # What a file had before there was this setting stays.
        if scene.library is None and scene.facemime.is_property_set("keep_calibrations"):
            _follow_keeping(scene.facemime)


def _follow_keeping(settings: FacemimeSettings) -> None:
    """Store the calibrations of a scene in the file, or remove them from it, as its setting says.

    That is done before a file is saved, as a setting that calls a function makes Blender 4.2 crash when it quits.
    """
    for performer in settings.performers:
        for name in _KNOWN:
            text = _known(performer, name)
            if text:
                performer.key = performer.key or uuid4().hex
                _session[performer.key, name] = text
            setattr(performer, name, text if settings.keep_calibrations else "")


def stored_performers() -> list[FacemimePerformer]:
    """Return the performers whose calibrations are stored in the open .blend file, of all its scenes."""
    return [performer for performer in _everybody() if any(getattr(performer, name) for name in _KNOWN)]


def clear_file() -> None:
    """Remove the calibrations of all performers from the open .blend file, and store none from now on."""
    for scene in bpy.data.scenes:
        if scene.library is None:
            scene.facemime.keep_calibrations = False
            for performer in scene.facemime.performers:
                for name in _KNOWN:
                    setattr(performer, name, "")


HANDLERS = {"save_pre": _before_saving}
