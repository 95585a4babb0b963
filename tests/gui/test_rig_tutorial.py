"""A rig's own controls, by mouse: Rigify's face from Learn Controls to a corrected bake.

The rig is ../shared/data/rigs/rigify.blend, beside the repository: the face of Rigify's human on the built-in head. As
in `test_pictures`, the picture is checked for what the page says of it.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from tests.gui.conftest import QUICK, SUITES, installed
from tests.gui.test_pictures import changed, coloured
from tests.helpers.gui.studio import Studio
from tests.helpers.gui.walking import TOOLS, middle
from tests.helpers.gui.window import ROOT

pytestmark = pytest.mark.thorough

RIG = ROOT.parent / "shared" / "data" / "rigs" / "rigify.blend"
_SIZE = (1366, 1060)
_LENGTH = 4.0
"""Seconds of the sample clip that are recorded."""
_TO_CONTROLS, _TO_CURVE = 8, 60
"""Steps of the wheel after which the panel Controls is in view, and the end of the tab."""
_HEAD = "bpy.data.objects['Facemime Head']"
_RIG = "next(obj for obj in bpy.data.objects if obj.type == 'ARMATURE' and 'jaw_master' in obj.pose.bones)"
_BAKE = "bpy.context.scene.facemime_takes.bake"
_FRONT = f"""
for obj in bpy.data.objects:
    obj.select_set(obj == {_HEAD})
bpy.context.view_layer.objects.active = {_HEAD}
for area in bpy.context.window.screen.areas:
    if area.type == "VIEW_3D":
        area.spaces.active.overlay.show_bones = False
        area.spaces.active.show_region_ui = True
"""
_WIDEST = f"""
jaw = {_RIG}.pose.bones["jaw_master"]
def opening(frame):
    bpy.context.scene.frame_set(frame)
    return jaw.matrix_basis.to_quaternion().angle
value = max(range(1, 86), key=opening)
"""
"""The frame in which the mouth is widest."""
_CHANNELS = f"[[list(bone.location), list(bone.matrix_basis.to_quaternion())] for bone in {_RIG}.pose.bones]"


@pytest.fixture(params=SUITES)
def studio(request: pytest.FixtureRequest) -> Iterator[Studio]:
    """The window with the rig, whose file is opened; nothing may be printed as an error."""
    if not RIG.exists():
        pytest.skip("../shared/data/rigs/rigify.blend is missing")
    with installed(request.param, "pictures-rig", size=_SIZE) as blender:
        studio = Studio("rig" if request.param == QUICK else f"rig-{request.param}", blender)
        shutil.copy(RIG, blender.folder / "rigify.blend")
        blender.do(f"bpy.ops.wm.open_mainfile(filepath={str(blender.inside / 'rigify.blend')!r}, load_ui=False)")
        blender.do(TOOLS)
        blender.do(_FRONT)
        blender.redraw()
        yield studio
        assert "Traceback" not in blender.printed()


def look_from_the_front(studio: Studio) -> None:
    """View the head from the front."""
    studio.blender.move(*studio.sidebar.view())
    studio.blender.redraw()
    for key in ("KP_1", "KP_Decimal"):
        studio.blender.key(key)
    studio.blender.redraw()


def test_rigify_s_face_is_learnt_reduced_to_few_controls_and_baked_to(studio):
    blender = studio.blender
    look_from_the_front(studio)
    learn(studio)
    rank(studio)
    record(studio)
    bake(studio)
    frames = [blender.get(f"[bpy.context.scene.frame_set({frame}), {_CHANNELS}][1]") for frame in (1, 60)]
    assert frames[0] != frames[1]
    used = blender.get(f"[item.name for item in {_HEAD}.facemime_rig.controls if item.use]")
    unused = blender.get(f"[item.name for item in {_HEAD}.facemime_rig.controls if not item.use]")
    names = blender.get(f"list({_RIG}.pose.bones.keys())")
    moved = {name for name, one, other in zip(names, *frames, strict=True) if one != other}
    assert len(moved & set(used)) > 10 and not moved & set(unused)


def learn(studio: Studio) -> None:
    """Learn the controls, and show what each does."""
    blender, sidebar = studio.blender, studio.sidebar
    sidebar.open_panel("FACEMIME_PT_head", children=True)
    studio.rest = middle(sidebar, studio.shot("rest"))
    before = blender.get(_CHANNELS)
    studio.press("learn_controls")
    blender.wait_for(f"len({_HEAD}.facemime_rig.controls) > 50", 400.0)
    assert blender.get(_CHANNELS) == before, "every channel is as it was"
    sidebar.scroll_down(_TO_CONTROLS)
    box, (_, y) = sidebar.box(), sidebar.find("facemime_steps.arrows")
    blender.click(box.x + 0.85 * (box.width - sidebar.unit), y)
    blender.redraw()
    assert blender.get("bpy.context.scene.facemime_steps.arrows") == "ALL"
    arrows = middle(sidebar, studio.shot("arrows"))
    assert min(coloured(arrows, *hues) for hues in ((170, 180), (42, 52), (98, 108))) > 2e-4, "arrows of each axis"


def rank(studio: Studio) -> None:
    """Rank the controls for ARKit's expressions in the menu below the arrows, and use few of them."""
    blender, sidebar = studio.blender, studio.sidebar
    x, y = sidebar.find('bpy.ops.wm.call_menu(name="FACEMIME_MT_rank_controls")')
    blender.click(x, y)
    blender.redraw()
    studio.shot("menu")
    blender.click(x, y + 1.2 * sidebar.unit)
    blender.wait_for(f"{_HEAD}.facemime_rig.few > 50", 120.0)
    sidebar.scroll_down(_TO_CURVE)
    blender.move(*sidebar.find("facemime_rig.few"))
    blender.redraw()
    for key in ("Return", "ctrl+a", "3", "2", "Return"):
        blender.key(key)
        blender.redraw()
    assert 30 <= blender.get(f"sum(item.use for item in {_HEAD}.facemime_rig.controls)") <= 33
    studio.picture("few", studio.shot("few"))


def record(studio: Studio) -> None:
    """Record the sample clip, driving the skin."""
    blender, sidebar = studio.blender, studio.sidebar
    blender.do("bpy.context.scene.render.fps = 25; bpy.ops.wm.save_mainfile()")
    sidebar.open_panel("FACEMIME_PT_takes")
    studio.start(0.6)
    studio.press("record_take")
    studio.play(_LENGTH)
    studio.press("record_take")
    blender.wait_for("len(bpy.context.scene.facemime_takes.items) == 1")
    studio.stop()


def bake(studio: Studio) -> None:
    """Choose the controls with the wheel, and bake."""
    blender, sidebar = studio.blender, studio.sidebar
    sidebar.open_panel("FACEMIME_PT_takes", children=True)
    place = sidebar.find("bake.keys")
    for _ in range(12):
        if blender.get(f"{_BAKE}.keys") == "controls":
            break
        blender.input("mousemove", *map(round, place), "keydown", "ctrl", "click", 5, "keyup", "ctrl")
        blender.redraw()
    assert blender.get(f"{_BAKE}.keys") == "controls"
    studio.press("bake_take")
    blender.wait_for(f"{_RIG}.animation_data is not None and {_RIG}.animation_data.action is not None", 240.0)
    blender.do("bpy.context.scene.facemime_steps.arrows = 'NONE'")
    blender.do(f"bpy.context.scene.frame_set({blender.do(_WIDEST)})")
    blender.redraw()
    baked = studio.picture("baked", studio.shot("baked"))
    assert changed(baked, studio.rest) > 0.01
