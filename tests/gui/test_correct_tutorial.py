"""The tutorial on corrections, walked by mouse from Blender's default scene in both versions of Blender.

As in `test_pictures`, each picture is checked for what the page says of it; those of the newest Blender are kept.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.gui.conftest import QUICK, SUITES, installed
from tests.gui.test_pictures import add_head_with_keys, changed, save_project
from tests.helpers.gui.studio import Studio
from tests.helpers.gui.walking import HEAD, middle
from tests.helpers.gui.window import MODULE, Blender

pytestmark = pytest.mark.thorough

_SIZE = (1366, 1060)
_LENGTH = 9.9
"""Seconds of the sample clip that are recorded."""
_TO_CORRECTIONS = 8
"""Steps of the wheel after which the end of the panel Bake is in view."""
_CORRECTED = 60
"""Frame at which the layer opens the mouth less."""
_EDIT = f"__import__({MODULE!r} + '.sessions.landmark_edit', fromlist=['x']).LandmarkEdit.current"
_STORE = f"__import__({MODULE!r} + '.settings.takes_store', fromlist=['x'])"
_VIEW = """
area = max((a for a in bpy.context.window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width)
region = next(r for r in area.regions if r.type == "WINDOW")
value = [region.x, bpy.context.window.height - region.y]
"""
_TAKE = "bpy.context.scene.facemime_takes.items[bpy.context.scene.facemime_takes.index]"
_KEYS = f"{HEAD}.data.shape_keys"
_JAW = f"{_KEYS}.key_blocks['jawOpen']"


@pytest.fixture(params=SUITES)
def studio(request: pytest.FixtureRequest) -> Iterator[Studio]:
    """The window of the tutorial; nothing may be printed as an error."""
    with installed(request.param, "pictures-correct", size=_SIZE) as blender:
        studio = Studio("correct" if request.param == QUICK else f"correct-{request.param}", blender)
        yield studio
        assert "Traceback" not in blender.printed()


def landmark(blender: Blender, number: int) -> np.ndarray:
    """Return where a landmark that is edited is in the window."""
    left, bottom = blender.do(_VIEW)
    x, y = blender.get(f"list({_EDIT}.to_region({_EDIT}.landmarks[{number}]))")
    return np.array([left + x, bottom - y])


def drag(blender: Blender, number: int, down: float) -> None:
    """Drag a landmark down by pixels."""
    start = landmark(blender, number)
    blender.drag(tuple(start), tuple(start + (0.0, 0.5 * down)), tuple(start + (0.0, down)))


def go_to(blender: Blender, frame: int) -> None:
    blender.do(f"bpy.context.scene.frame_set({frame})")
    blender.redraw()


def test_a_take_is_corrected_by_pins_examples_and_a_layer_that_survive_another_bake(studio):
    blender, sidebar = studio.blender, studio.sidebar
    record(studio)
    studio.press("show_take")
    viewport = middle(sidebar, studio.shot("preview"))
    # Pins in two frames.
    studio.press("next_doubtful_frame")
    studio.press("edit_landmarks")
    blender.wait_for(f"{_EDIT} is not None")
    blender.move(*sidebar.view(0.3, 0.9))
    blender.redraw()
    for number in range(2):
        drag(blender, 57, 14.0)
        blender.wait_for(f"len({_EDIT}.editor.pins()) == 1")
        if number == 0:
            blender.move(*(landmark(blender, 57) + (1.0, 1.0)))
            pinned = studio.picture("landmarks", studio.shot("landmarks"))
            assert min(changed(pinned, viewport), changed(pinned, 0 * pinned)) > 0.5, "the image of the frame is shown"
            blender.key("ctrl+z")
            blender.wait_for(f"len({_EDIT}.editor.pins()) == 0")
            blender.key("ctrl+shift+z")
            blender.wait_for(f"len({_EDIT}.editor.pins()) == 1")
            blender.key("n")
            blender.wait_for(f"len({_EDIT}.editor.pins()) == 0")
    blender.key("Return")
    blender.wait_for(f"{_EDIT} is None and len({_STORE}.pins_of({_STORE}.read({_TAKE}))) == 2")
    studio.shows("learn_from_pins")
    blender.key("ctrl+z")
    blender.wait_for(f"len({_STORE}.pins_of({_STORE}.read({_TAKE}))) == 0")
    blender.key("ctrl+shift+z")
    blender.wait_for(f"len({_STORE}.pins_of({_STORE}.read({_TAKE}))) == 2")
    teach(studio)
    bake_and_correct(studio)


def record(studio: Studio) -> None:
    """Add a head with ARKit's keys, save the file, and record the sample clip."""
    blender, sidebar = studio.blender, studio.sidebar
    add_head_with_keys(studio)
    blender.do("bpy.context.scene.render.fps = 25")
    save_project(studio)
    studio.start(0.6)
    sidebar.open_panel("FACEMIME_PT_takes")
    studio.press("record_take")
    studio.play(_LENGTH)
    studio.press("record_take")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 1")
    studio.stop()


def teach(studio: Studio) -> None:
    """Teach the head two frames, in which the user adds to a smile and to the brows."""
    blender, sidebar = studio.blender, studio.sidebar
    sidebar.open_panel("FACEMIME_PT_teaching")
    for number, (key, value) in enumerate((("mouthSmileLeft", 0.6), ("browInnerUp", 0.7))):
        studio.press("suggest_frames")
        blender.do(f"{_KEYS}.key_blocks[{key!r}].value = {value}")
        blender.redraw()
        before = blender.get(f"shown({HEAD}).tolist()")
        studio.press("teach_frame")
        blender.wait_for(f"len({HEAD}.facemime_style.examples) == {number + 1}")
        blender.wait_for(f"{_KEYS}.key_blocks[{key!r}].value == 0.0")
        after = blender.get(f"shown({HEAD}).tolist()")
        assert np.abs(np.subtract(before, after)).max() < 2e-3, "the head looks as it was taught"
    studio.picture("teaching", studio.shot("teaching"))


def bake_and_correct(studio: Studio) -> None:
    """Bake, correct the bake on a layer, mend the take, bake again, and export."""
    blender, sidebar = studio.blender, studio.sidebar
    sidebar.open_panel("FACEMIME_PT_takes", children=True)
    studio.press("bake_take")
    blender.wait_for(f"{_KEYS}.animation_data is not None and {_KEYS}.animation_data.action is not None")
    sidebar.scroll_down(_TO_CORRECTIONS)
    studio.press("add_corrections")
    blender.wait_for(f"{_KEYS}.animation_data.action.name.endswith('Corrections')")
    for frame in (_CORRECTED - 10, _CORRECTED + 10):
        go_to(blender, frame)
        blender.do(f"{_JAW}.keyframe_insert('value')")
    go_to(blender, _CORRECTED)
    blender.do(f"{_JAW}.value = 0.05; {_JAW}.keyframe_insert('value')")
    blender.redraw()
    corrected = studio.picture("layer", studio.shot("layer"))
    sidebar.open_panel("FACEMIME_PT_takes")
    studio.press("mend_take")
    blender.redraw()
    blender.key("Return")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 2")
    assert blender.get(f"len({_STORE}.pins_of({_STORE}.read({_TAKE})))") == 2
    sidebar.open_panel("FACEMIME_PT_takes", children=True)
    studio.press("bake_take")
    blender.redraw()
    go_to(blender, _CORRECTED)
    assert blender.get(f"{_JAW}.value") == pytest.approx(0.05, abs=0.03), "the layer stays"
    assert changed(middle(sidebar, studio.shot("again")), corrected) < 0.02
    blender.do(f"bpy.ops.facemime.export_gltf(filepath={str(blender.inside / 'performance.glb')!r})")
    assert (blender.folder / "performance.glb").stat().st_size > 1e5
