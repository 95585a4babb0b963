"""Presets that Facemime ships, and the contents of presets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..control_points.selection_settings import SelectionSettings
from ..drive.drive_settings import DriveSettings, PosingSettings
from ..errors import SourceError, messages
from ..files.assets import ASSETS
from ..files.preset_files import SUFFIX, Values, from_json
from ..files.reading import read_text
from ..files.setting import Setting, settings_of
from ..tracking.tracking_settings import TrackingSettings
from .puppet_settings import PuppetSettings

BUILT_IN = messages(
    {"calm_speech": "Calm Speech", "strong": "Strong", "cartoon": "Cartoon", "yao_2019": "Yao et al. 2019"}
)
"""Labels of the shipped presets by file name; these cannot be removed."""
COMMAND_NAMES = {"calm-speech": "calm_speech", "strong": "strong", "cartoon": "cartoon", "paper": "yao_2019"}
"""Names of the shipped presets on the command line."""
CONTENTS: Mapping[str, Mapping[str, Setting]] = {
    "settings": {**settings_of(DriveSettings), **settings_of(PuppetSettings), **settings_of(TrackingSettings)},
    "posing": settings_of(PosingSettings),
    "selection": {"search": settings_of(SelectionSettings)["search"]},
}
"""Settings in a preset, by group."""


def built_in_path(name: str) -> Path:
    """Return the path of a shipped preset, a key of `BUILT_IN`."""
    return ASSETS / "presets" / f"{name}{SUFFIX}"


def read_preset(path: Path) -> Values:
    """Read a preset, and return the values of its settings by group.

    Raises
    ------
    SourceError
        If the file is missing or not a preset.
    """
    try:
        return from_json(read_text(path), CONTENTS)
    except (OSError, ValueError) as error:
        raise SourceError(
            "{path} is not a valid preset ({error}). Choose another file.", path=path, error=error
        ) from error
    except SourceError as error:
        raise SourceError("{path}: {error}", path=path, error=error) from error
