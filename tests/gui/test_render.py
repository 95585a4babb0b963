"""A take that is shown while an animation is rendered, in the thread of the renderer."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from facemime.core.takes.file import save_take
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import HEAD, add_head
from tests.helpers.gui.window import MODULE
from tests.helpers.takes import performance

pytestmark = pytest.mark.thorough
_SHOW = f"""
import math
from pathlib import Path
from {MODULE}.core.takes.file import load_take
from {MODULE}.sessions import show
from {MODULE}.sessions.show import TakeShow
scene, head = bpy.context.scene, {HEAD}
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
scene.render.resolution_x = scene.render.resolution_y = 96
scene.render.fps, scene.frame_start, scene.frame_end, scene.frame_step = 25, 28, 40, 4
scene.camera.location = head.location + head.location.__class__((0.0, -0.5, 0.0))
scene.camera.rotation_euler, scene.camera.data.clip_start = (math.pi / 2, 0.0, 0.0), 0.01
scene.render.use_lock_interface = {{locked}}
messages = []
show.show_error = messages.append
TakeShow(scene, [head], load_take(Path({{take!r}})))
scene.frame_set(28)
scene.render.filepath = {{output!r}}
bpy.ops.render.render("INVOKE_DEFAULT", animation=True)
"""


@pytest.mark.parametrize("locked", [True, False])
def test_a_rendered_animation_shows_each_frame_of_a_take_or_says_that_it_cannot(blender, sidebar: Sidebar, locked):
    add_head(sidebar)
    save_take(performance(), blender.folder / "take.facetake")
    place = blender.inside / f"locked-{locked}-"
    blender.do(_SHOW.format(locked=locked, take=str(blender.inside / "take.facetake"), output=str(place)))
    blender.wait_for("bpy.app.is_job_running('RENDER')")
    blender.wait_for("not bpy.app.is_job_running('RENDER')")
    paths = sorted(blender.folder.glob(f"{place.name}*.png"))
    images = [cv2.imread(str(path)).astype(float) for path in paths]
    changes = [np.abs(after - before).mean() for before, after in pairwise(images)]
    said = "\n".join(map(str, blender.get("messages")))
    assert len(images) == 4 and blender.get("TakeShow.running() is not None")
    if locked:
        assert min(changes) > 0.1 and not said
    else:
        assert max(changes) == 0.0
        blender.wait_for("any('Lock Interface' in str(one) for one in messages)")
    blender.do("TakeShow.running().close()")
