"""The heads that browsers show: their models, made again when the heads change, and frames of them."""

from __future__ import annotations

import json
from collections.abc import Sequence

from ..drive.driver import HeadDriver
from ..errors import FacemimeError
from ..heads.appearance import Appearance
from ..live.key_driver import KeyDriver
from .model import ViewerModel, viewer_model
from .page import digest


class Scene:
    """The heads that are shown.

    Parameters
    ----------
    appearances : sequence of Appearance
        Appearance of each head.

    Attributes
    ----------
    models : tuple of ViewerModel
        What pages load; empty if a head cannot be shown.
    number : int
        Increases with every change.
    path : str
        Folder of the models, which depends on their content alone.
    message : str
        Reason why the heads cannot be shown; otherwise "".
    """

    def __init__(self, appearances: Sequence[Appearance]) -> None:
        self.models: tuple[ViewerModel, ...] = ()
        self.number, self.path, self.message = 0, "", ""
        self._appearances = tuple(appearances)
        self._made_of: list[object] = []

    def update(self, drivers: Sequence[HeadDriver | KeyDriver]) -> bool:
        """Make the models again if the heads or their deformers have changed, and return whether they have."""
        made_of = [part for driver in drivers for part in _made_of(driver)]
        if len(made_of) == len(self._made_of) and all(a is b for a, b in zip(made_of, self._made_of, strict=True)):
            return False
        self._made_of = made_of
        try:
            self.models, self.message = tuple(map(viewer_model, drivers, self._appearances)), ""
        except FacemimeError as error:
            self.models, self.message = (), str(error)
        self.number += 1
        self.path = digest(*[data for model in self.models for data in (model.data, *model.images)])
        return True


def description(number: int, path: str, models: Sequence[ViewerModel]) -> str:
    """Return the description of a scene that pages load first, JSON."""
    return json.dumps({"scene": number & 0xFFFF, "path": path, "images": [len(model.images) for model in models]})


def _made_of(driver: HeadDriver | KeyDriver) -> tuple[object, ...]:
    """Return the objects that a model depends on, compared by identity; a new calibration keeps them."""
    head = driver.head if isinstance(driver, KeyDriver) else driver
    return driver.keys if isinstance(driver, KeyDriver) else None, head.rig, head.deformer
