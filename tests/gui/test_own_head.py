"""A mesh becomes a head by mouse: face, regions, control points, cuts."""

from __future__ import annotations

import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest

from facemime.core.files.assets import ASSETS
from facemime.core.takes.file import save_take
from tests.helpers.gui.sidebar import Sidebar
from tests.helpers.gui.walking import (
    HEAD,
    PIXEL_OF_FOREHEAD,
    PIXEL_OF_LANDMARK,
    add_head,
    look_from_the_front,
    middle,
    run_in_viewport,
    start,
    stop,
)
from tests.helpers.gui.window import ROOT, Blender, wait
from tests.helpers.scans import write_scan
from tests.helpers.takes import performance

pytestmark = pytest.mark.thorough


def test_a_brush_stroke_takes_effect_while_the_puppet_is_running(blender, sidebar):
    add_head(sidebar)
    start(sidebar)
    sidebar.open_panel("FACEMIME_PT_regions")
    sidebar.press("bpy.ops.facemime.paint_region(region='LOWER')")
    blender.wait_for("bpy.context.mode == 'PAINT_WEIGHT'")
    blender.do(f"before = read_regions({HEAD})[2].copy()")
    forehead = blender.do(PIXEL_OF_FOREHEAD)
    blender.drag(*[(forehead[0] + x, forehead[1]) for x in (-20, -10, 0, 10, 20)])
    blender.wait_for(f"(read_regions({HEAD})[2] > before + 0.2).any()")
    blender.shot("stroke")
    blender.do(f"painted = read_regions({HEAD})[2] > before + 0.2")
    blender.wait_for("(Session.current.worker.heads[0].rig.region_weights[2][painted] > 0.2).all()")
    blender.wait_for(f"np.abs(shown({HEAD}) - rest({HEAD}))[painted].max() > 1e-4")
    stop(sidebar)
    assert blender.get("bpy.context.mode") == "PAINT_WEIGHT"


def test_regions_are_shown_edited_and_checked_by_clicks(blender, sidebar):
    add_head(sidebar)
    sidebar.open_panel("FACEMIME_PT_regions")
    plain = cv2.imread(str(blender.shot("regions-hidden")))
    sidebar.press("show_regions")
    shown = cv2.imread(str(blender.shot("regions-shown")))
    x, y = (round(value) for value in blender.do(PIXEL_OF_FOREHEAD))
    change = shown[y - 3 : y + 4, x - 3 : x + 4].astype(float).mean(axis=(0, 1)) - plain[y, x]
    assert change[0] > change[2] + 20, "the forehead turns blue"
    for button in ("mirror_regions(source='left')", "smooth_regions", "propose_regions", "check_head"):
        sidebar.press(f"bpy.ops.facemime.{button}")
    assert blender.get("bpy.context.window_manager.facemime.checked") == blender.get(f"{HEAD}.name")
    listed = cv2.imread(str(blender.shot("checked")))
    blender.key("Escape")
    blender.redraw()
    closed = cv2.imread(str(blender.shot("check-closed")))
    assert (np.abs(listed.astype(int) - closed).max(axis=2) > 40).mean() > 0.02, "the parts are listed in a popup"
    sidebar.press("bpy.ops.facemime.paint_region(region='MIDDLE')")
    blender.wait_for(f"{HEAD}.vertex_groups.active.name == 'Facemime Middle'")
    blender.shot("painting")
    sidebar.press("bpy.ops.facemime.leave_painting")
    blender.wait_for("bpy.context.mode == 'OBJECT'")


ALONE = """sorted(
    obj.name for obj in bpy.context.view_layer.objects for area in bpy.context.window.screen.areas
    if area.type == "VIEW_3D" and area.spaces.active.local_view is not None
    and obj.evaluated_get(bpy.context.view_layer.depsgraph).local_view_get(area.spaces.active)
)"""
"""The objects in the Local View of the viewport; Blender 4.3 gives it for evaluated objects only."""


def import_scan(blender: Blender) -> int:
    """Import a scan as an OBJ file and make it active; returns the number of its vertices."""
    count = write_scan(blender.folder / "scan.obj")
    blender.do(f"bpy.ops.wm.obj_import(filepath={str(blender.inside / 'scan.obj')!r})")
    blender.do("bpy.context.view_layer.objects.active = bpy.data.objects['scan']")
    return count


def test_an_imported_scan_becomes_a_head_with_open_mouth_and_eyes_by_clicks(blender, sidebar):
    count = import_scan(blender)
    blender.redraw()
    sidebar.open_panel("FACEMIME_PT_head")
    sidebar.press("bpy.ops.facemime.bind_landmarks")
    blender.wait_for("'facemime_landmarks' in bpy.data.objects['scan'].data")
    blender.wait_for(f"{ALONE} == ['Light', 'scan']")
    sidebar.press("bpy.ops.facemime.open_lips")
    blender.wait_for(f"len(bpy.data.objects['scan'].data.vertices) > {count}")
    sidebar.press("bpy.ops.facemime.open_eyes")
    blender.wait_for("'Facemime Eyes' in bpy.data.objects['scan'].vertex_groups")
    blender.wait_for("len(bpy.context.window_manager.facemime.findings) == 0")
    look_from_the_front(sidebar)
    blender.shot("scan")
    start(sidebar)
    sidebar.open_panel("FACEMIME_PT_puppet")
    sidebar.press("bpy.ops.facemime.next_face")
    gap = f"shown({HEAD})[read_landmarks({HEAD})[from_ibug([62, 66])], 2]"
    blender.wait_for(f"float(np.ptp({gap})) > 0.01")
    blender.shot("scan-speaks")
    stop(sidebar)


def test_the_painted_eyes_of_a_head_from_a_file_turn_after_a_click(blender, sidebar):
    for name, of in (("Head.tri", "Jane.tri"), ("Head.jpg", "Jane.jpg"), ("Mouth.tri", "Mouth.tri")):
        shutil.copy(ASSETS / "facegen" / of, blender.folder / name)
    blender.do(f"bpy.ops.facemime.import_facegen(filepath={str(blender.inside / 'Head.tri')!r})")
    blender.redraw()
    sidebar.open_panel("FACEMIME_PT_head")
    sidebar.press("bpy.ops.facemime.bind_landmarks")
    blender.wait_for("'facemime_landmarks' in bpy.data.objects['Head'].data")
    sidebar.press("bpy.ops.facemime.open_eyes")
    blender.wait_for("len([child for child in bpy.data.objects['Head'].children if 'Eye' in child.name]) == 2")
    assert blender.get("len(bpy.context.window_manager.facemime.findings)") == 0
    look_from_the_front(sidebar)
    blender.shot("painted-eyes-opened")
    blender.key("ctrl+z")
    blender.wait_for("not [obj for obj in bpy.data.objects if 'Eye' in obj.name]")


_CHARACTER = """
with bpy.data.libraries.load({path!r}) as (there, here):
    here.objects = there.objects
for obj in here.objects:
    bpy.context.collection.objects.link(obj)
body = max(here.objects, key=lambda obj: obj.dimensions.z if obj.type == "MESH" else 0.0)
body.select_set(True)
bpy.context.view_layer.objects.active = body
"""
_AS_ONE = f"""
bpy.context.view_layer.update()
armature = {HEAD}.parent
bone = armature.pose.bones["Head"]
turn = np.array(bone.matrix @ bone.bone.matrix_local.inverted())
value = None
if bone.matrix_basis.to_quaternion().angle > 0.1:
    value = {{}}
    for obj in armature.children:
        before, now = rest(obj), shown(obj)
        ends = np.array([edge.vertices[:] for edge in obj.data.edges])
        lengths = [np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1) for points in (before, now)]
        away = now.mean(axis=0) - before.mean(axis=0) @ turn[:3, :3].T - turn[:3, 3]
        kind = "body" if obj == body else "skin" if obj == {HEAD} else obj.name
        stretched = float(np.abs(lengths[1] - lengths[0]).max())
        value[kind] = [float(np.abs(now - before).max()), float(np.linalg.norm(away)), stretched]
"""
"""How far each mesh moves, leaves the bone of the head, and is stretched; nothing while the head looks ahead."""


def shaded(sidebar: Sidebar, name: str) -> float:
    """Take a screenshot, and return the share of the viewport that differs from its most frequent colour."""
    picture = middle(sidebar, cv2.imread(str(sidebar.blender.shot(name)))).astype(int)
    return float((np.abs(picture - np.median(picture, axis=(0, 1))).max(axis=2) > 20).mean())


def test_a_rigged_character_with_eyes_teeth_and_hair_moves_as_one(blender, sidebar):
    path = blender.folder / "character.blend"
    subprocess.run(
        [sys.executable, "-m", "tests.helpers.characters", path], cwd=ROOT, check=True, stdout=subprocess.DEVNULL
    )
    blender.do(_CHARACTER.format(path=str(blender.inside / path.name)))
    blender.redraw()
    sidebar.press("bpy.ops.facemime.bind_landmarks")
    blender.wait_for(f"{HEAD} != body and 'facemime_landmarks' in {HEAD}.data")
    assert blender.get(f"'Cube' not in {ALONE} and set({ALONE}).issuperset(o.name for o in here.objects)")
    assert shaded(sidebar, "character-bound") > 0.1, "the default cube does not hide the face"
    sidebar.press("bpy.ops.facemime.accept_points")
    start(sidebar)
    parts = wait(lambda: blender.do(_AS_ONE), "a turned head")
    assert shaded(sidebar, "character") > 0.1
    assert len(parts) == 8 and parts.pop("body")[0] < 1e-6
    assert min(moved for moved, _, _ in parts.values()) > 0.005
    assert parts.pop("skin")[1] < 0.005
    hair, upper_teeth, *eyes, lower_teeth, tongue = sorted(away for _, away, _ in parts.values())
    assert max(hair, upper_teeth) < 1e-5 and max(eyes) < 2e-4, "the head carries them"
    assert max(lower_teeth, tongue) < 0.02, "the jaw carries them"
    assert sorted(stretched for _, _, stretched in parts.values())[-2] < 1e-4, "the tongue alone is soft"
    stop(sidebar)


def nose(blender: Blender) -> int:
    """Return the vertex of the tip of the nose."""
    return blender.get(f"int(read_landmarks({HEAD})[from_ibug([30])[0]])")


def test_landmarks_are_dragged_and_discarded_or_accepted(blender, sidebar):
    add_head(sidebar)
    blender.do("bpy.context.scene.facemime_steps.show_points = True")
    tip = nose(blender)
    x, y = blender.do(PIXEL_OF_LANDMARK.format(landmark="from_ibug([30])[0]"))
    for button, kept in (("discard_points", False), ("accept_points", True)):
        run_in_viewport(blender, "adjust_landmarks")
        sidebar.find("bpy.ops.facemime.accept_points")
        blender.drag((x, y), (x, y - 10), (x + 15, y - 20))
        blender.shot("dragged")
        assert nose(blender) != tip
        sidebar.press(f"bpy.ops.facemime.{button}")
        assert (nose(blender) != tip) == kept
    sidebar.find("bpy.ops.facemime.puppet")
    blender.move(*sidebar.view())
    blender.key("ctrl+z")
    blender.wait_for(f"int(read_landmarks({HEAD})[from_ibug([30])[0]]) == {tip}")


def test_four_points_that_are_clicked_one_by_one_lead_to_the_face(blender, sidebar):
    add_head(sidebar)
    bound = blender.get(f"read_landmarks({HEAD}).tolist()")
    places = [blender.do(PIXEL_OF_LANDMARK.format(landmark=f"from_ibug([{n}])[0]")) for n in (36, 45, 48, 54)]
    blender.do(f"del {HEAD}.data['facemime_landmarks']")
    run_in_viewport(blender, "mark_face")
    for place in places[:2]:
        blender.click(*place)
        blender.redraw()
    blender.shot("marking")
    blender.key("BackSpace")
    blender.redraw()
    assert blender.get(f"len({HEAD}.data['facemime_marks'])") == 2, "one mark: its number and its vertex"
    for place in places[1:]:
        blender.click(*place)
        blender.redraw()
    blender.key("Return")
    blender.wait_for(f"'facemime_landmarks' in {HEAD}.data")
    blender.shot("marked")
    found = blender.get(f"read_landmarks({HEAD}).tolist()")
    assert np.mean(np.array(found) == bound) > 0.6
    blender.wait_for("bpy.ops.facemime.accept_points.poll()")
    sidebar.press("bpy.ops.facemime.accept_points")


def test_escape_ends_the_search_for_a_face_and_leaves_nothing(blender, sidebar):
    import_scan(blender)
    blender.redraw()
    run_in_viewport(blender, "bind_landmarks")
    blender.move(*sidebar.view())
    blender.key("Escape")
    blender.wait_for("workers() == []")
    blender.redraw()
    assert not blender.get("[key for key in bpy.data.objects['scan'].data.keys() if key.startswith('facemime')]")


_NOT_ALONE = f"""
selection = read_selection({HEAD}.data)
alone = selection.membership[selection.membership.sum(axis=1) < 2].any(axis=0)
value = next(int(landmark) for landmark in selection.landmarks if not alone[landmark])
"""
"""A control point whose regions have others."""


def test_control_points_are_selected_from_a_take_picked_on_the_head_removed_and_undone(blender, sidebar):
    add_head(sidebar)
    save_take(performance(), blender.folder / "take.facetake")
    blender.do(f"bpy.ops.facemime.import_take(filepath={str(blender.inside / 'take.facetake')!r})")
    blender.do("bpy.context.scene.facemime_steps.tolerance = 0.1")
    sidebar.open_panel("FACEMIME_PT_control_points")
    x, y = sidebar.find("bpy.ops.facemime.select_live_points")
    blender.click(x, y - sidebar.unit)  # the menu right above the button
    blender.redraw()
    blender.shot("takes")
    blender.key("Down")
    blender.redraw()
    blender.key("Return")
    blender.wait_for(f"read_selection({HEAD}.data) is not None")
    count = blender.get(f"len(read_selection({HEAD}.data).landmarks)")
    sidebar.press("bpy.ops.facemime.pick_landmark")
    landmark = blender.do(_NOT_ALONE)
    blender.click(*blender.do(PIXEL_OF_LANDMARK.format(landmark=landmark)))
    blender.wait_for(f"bpy.context.scene.facemime_steps.landmark == {landmark}")
    blender.shot("control-points")
    sidebar.press("bpy.ops.facemime.drop_control_point")
    blender.wait_for(f"len(read_selection({HEAD}.data).landmarks) == {count - 1}")
    blender.move(*sidebar.view())
    blender.key("ctrl+z")
    blender.wait_for(f"len(read_selection({HEAD}.data).landmarks) == {count}")
