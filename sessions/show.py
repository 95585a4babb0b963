"""Display of a take on heads at the current frame, without baking."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..blender.animation.live import Follow, LiveHeadObject, require_one_left
from ..blender.animation.live_keys import KEYS, live_keys
from ..blender.animation.scene_range import fit_range
from ..blender.meshes import driven_by_keys
from ..blender.rigs import read_rig
from ..blender.timeline import frames_of, seconds_of
from ..blender.undo import push_undo
from ..core.drive.driver import HeadDriver
from ..core.errors import HeadError
from ..core.live.key_driver import KeyDriver
from ..core.puppet.performance import Performance
from ..core.takes.take import Take
from ..settings.values import place_take, pose_targets, puppet_settings
from .session import Session


def _driver(performance: Performance, obj: bpy.types.Object) -> HeadDriver | KeyDriver:
    driver = performance.driver(read_rig(obj))
    return KeyDriver(driver, performance.neutral, live_keys(obj, KEYS)) if driven_by_keys(obj) else driver


class TakeShow(Session):
    """Displays a take on heads at the current frame until `close`, in time with a bake.

    Parameters
    ----------
    scene : bpy.types.Scene
        Its settings and frame are followed.
    objects : sequence of bpy.types.Object
        The heads.
    take : Take

    Raises
    ------
    FacemimeError
        If a head cannot be driven, or the take contains no face.
    """

    def __init__(self, scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], take: Take) -> None:
        if not objects:
            raise HeadError("No head is selected. Use Add > Mesh > Facemime Head, or find the face of your own.")
        settings = scene.facemime
        performance = Performance.of(take, puppet_settings(settings))
        follow = Follow(settings.rotation, settings.translation)
        self._heads = [
            (
                LiveHeadObject(obj, pose_targets(settings.posing, obj), follow),
                _driver(performance, obj),
            )
            for obj in objects
        ]
        self._take = performance.take.part(performance.take.found)
        self._scene = scene.name
        super().__init__()
        bake = scene.facemime_takes.bake
        self._start = place_take(scene)
        fit_range(scene, frames_of(scene, take.times, self._start), bake.start, asked=bake.fit_range)
        self.resume()
        push_undo("Preview on Head")

    def show(self, scene: bpy.types.Scene) -> None:
        """Display the frame of the take nearest to the current frame; raises HeadError as `LiveHeadObject.write`."""
        if scene.name != self._scene:
            return
        result = self._take.result(int(np.abs(self._take.times - seconds_of(scene, self._start)).argmin()))
        require_one_left([shown for shown, _ in self._heads])
        for shown, driver in self._heads:
            if not shown.gone:
                shown.write(driver.frame(result))

    def suspend(self) -> None:
        """Restore the heads while the file is saved."""
        for shown, _ in self._heads:
            shown.detach(keep=False, blocks=False)

    def resume(self) -> None:
        """Display the take on the heads."""
        for shown, _ in self._heads:
            shown.attach()
        if (scene := bpy.data.scenes.get(self._scene)) is not None:
            self.show(scene)

    def _restore(self, *, blocks: bool) -> None:
        removed = [shown.detach(keep=False, blocks=blocks) for shown, _ in self._heads]
        if any(removed):
            push_undo("Stop Showing Take")


@persistent
def _show(scene: bpy.types.Scene, *_: object) -> None:
    session = TakeShow.running()
    if session is None or bpy.app.is_job_running("RENDER"):
        return
    try:
        session.show(scene)
    except HeadError:  # the heads were changed or deleted
        session.close()


HANDLERS = {"frame_change_post": _show}
