"""Panels draw in every state, tested without a window."""

import sys
from types import SimpleNamespace

import blf
import bpy
import pytest

from facemime.blender.heads.binding import write_marks
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import write_selection
from facemime.blender.names import REGION_GROUPS, SELECTION_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.blender.viewports import free_box
from facemime.core.control_points.select import select_control_points
from facemime.core.face.landmarks import IBUG68_INDICES
from facemime.core.heads.regions import REGIONS
from facemime.core.takes.file import save_take
from facemime.operators.calibrate import FACEMIME_OT_calibrate
from facemime.settings import takes_store
from facemime.settings.preferences import preferences
from facemime.ui.control_points import (
    FACEMIME_MT_select_from_take,
    FACEMIME_PT_control_points,
    FACEMIME_UL_landmarks,
    shown_rows,
)
from facemime.ui.drawing import wrap
from facemime.ui.head import FACEMIME_PT_check, FACEMIME_PT_own_head, FACEMIME_PT_regions
from facemime.ui.menus import VIEW3D_MT_facemime
from facemime.ui.puppet import FACEMIME_PT_bake, FACEMIME_PT_expression, FACEMIME_PT_pose, FACEMIME_PT_puppet
from facemime.ui.source import FACEMIME_PT_calibration, FACEMIME_PT_source
from facemime.ui.start import FACEMIME_PT_start
from facemime.ui.takes import (
    FACEMIME_MT_takes,
    FACEMIME_PT_key_map,
    FACEMIME_PT_take_bake,
    FACEMIME_PT_takes,
    FACEMIME_UL_key_rows,
    FACEMIME_UL_takes,
)
from tests.helpers.characters import TRUTH, make_character
from tests.helpers.live_ticks import wait_for
from tests.helpers.panels import Layout, draw
from tests.helpers.takes import performance


def nothing() -> None:
    """Leave the scene empty."""


def cube() -> None:
    bpy.ops.mesh.primitive_cube_add()


def marked_head() -> None:
    write_marks(add_head(bpy.context).data, {30: 5})


def editing() -> None:
    marked_head()
    bpy.ops.object.mode_set(mode="EDIT")


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (nothing, "Select a character, or add a head"),
        (cube, "facemime.bind_landmarks"),
        (marked_head, "Marked points: 1"),
        (editing, "facemime.set_landmark"),
    ],
)
def test_the_panel_your_own_head_draws_in_every_state(state, expected):
    state()
    assert expected in draw(FACEMIME_PT_own_head)


def test_control_points_show_curve_and_list():
    head = add_head(bpy.context)
    assert FACEMIME_PT_control_points.poll(bpy.context)
    drawn = draw(FACEMIME_PT_control_points)
    assert "All 66 landmarks" in drawn and "template_icon" not in drawn
    selection = select_control_points(read_rig(head), performance(), max_points=12)
    write_selection(head.data, selection)
    drawn = draw(FACEMIME_PT_control_points)
    assert f"{len(selection.landmarks)} control points" in drawn and "FACEMIME_UL_landmarks" in drawn


def test_the_takes_of_the_list_are_offered_and_select_as_their_files_do(in_a_project, tmp_path):
    head = add_head(bpy.context)
    for name in ("First", "Second"):
        takes_store.keep(bpy.context.scene, performance(), name)
    drawn = draw(FACEMIME_MT_select_from_take)
    assert drawn.index("First") < drawn.index("Second") < drawn.index("From File...")
    assert bpy.ops.facemime.select_control_points(take=1, max_points=12) == {"FINISHED"}
    listed = head.data[SELECTION_PROPERTY]
    bpy.ops.facemime.select_control_points(filepath=str(tmp_path / "takes" / "Second.facetake"), max_points=12)
    assert head.data[SELECTION_PROPERTY] == listed
    with pytest.raises(RuntimeError, match="No take is selected"):
        bpy.ops.facemime.select_control_points(take=2)


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("Takes are stored in your folder", ["Takes are stored", "in your folder"]),
        (
            "\u4fdd\u5b58 .blend \u6587\u4ef6\u4e4b\u524d\uff0c\u5f55\u5236",
            ["\u4fdd\u5b58 .blend \u6587\u4ef6", "\u4e4b\u524d\uff0c\u5f55\u5236"],
        ),
    ],
)
def test_lines_of_any_language_fit_the_sidebar(text, lines):
    blf.size(0, 12.0)
    width = max(blf.dimensions(0, line)[0] for line in lines)
    assert wrap(text, width) == lines
    assert max(blf.dimensions(0, line)[0] for line in wrap(text, 1.0)) < width


def region(kind: str, x: int, y: int, width: int, height: int, alignment: str = "NONE") -> SimpleNamespace:
    return SimpleNamespace(type=kind, x=x, y=y, width=width, height=height, alignment=alignment)


def test_drawings_in_a_viewport_keep_clear_of_what_covers_it():
    view = region("WINDOW", 100, 50, 1000, 800)
    tools, side = region("TOOLS", 100, 50, 60, 750), region("UI", 820, 50, 280, 750)
    header, redo = region("HEADER", 100, 824, 1000, 26, "TOP"), region("HUD", 160, 60, 200, 90)
    shelf = region("ASSET_SHELF", 100, 50, 1000, 120, "BOTTOM")
    assert free_box(SimpleNamespace(regions=[tools, side, header, view]), view) == (60.0, 0.0, 720.0, 774.0)
    side.width = 1
    assert free_box(SimpleNamespace(regions=[tools, side, redo, view]), view) == (60.0, 100.0, 1000.0, 800.0)
    assert free_box(SimpleNamespace(regions=[shelf, view]), view) == (0.0, 120.0, 1000.0, 800.0)


def test_what_covers_one_view_of_a_quad_view_does_not_narrow_the_others():
    left, right = region("WINDOW", 0, 0, 500, 400), region("WINDOW", 500, 0, 500, 400)
    area = SimpleNamespace(regions=[region("TOOLS", 0, 0, 60, 400), left, right])
    assert free_box(area, left).left == 60.0 and free_box(area, right) == (0.0, 0.0, 500.0, 400.0)


def test_each_row_of_the_list_shows_number_region_order_and_error():
    head = add_head(bpy.context)
    write_selection(head.data, select_control_points(read_rig(head), performance(), max_points=12))
    layout, first = Layout(), next(row for row in shown_rows(head) if row.order == 1)
    FACEMIME_UL_landmarks.draw_row(None, bpy.context, layout, None, first.landmark)
    regions = ", ".join(REGIONS[row].name.capitalize() for row in first.regions)
    assert regions
    for part in (str(IBUG68_INDICES[first.landmark]), regions, f"1: {100 * first.error:.1f}%"):
        assert part in layout.texts()


def test_damaged_control_points_are_reported_and_can_be_reset():
    head = add_head(bpy.context)
    head.data[SELECTION_PROPERTY] = "{"
    drawn = draw(FACEMIME_PT_control_points)
    assert "not a control point file" in drawn and "facemime.use_all_landmarks" in drawn


def test_the_check_lists_the_parts_and_bones():
    objects = make_character(rig=True)
    bpy.context.view_layer.objects.active = objects["head"]
    bpy.ops.facemime.bind_landmarks()
    bpy.ops.facemime.check_head()
    drawn = draw(FACEMIME_PT_check)
    for text in ("Ready", "facemime.set_part", *(objects[name].name for name in TRUTH), "facemime.set_bone", "Head"):
        assert text in drawn


def test_the_check_of_a_head_without_bones_reports_how_it_turns():
    add_head(bpy.context)
    drawn = draw(FACEMIME_PT_check)
    assert "turns as a whole" in drawn and "Tongue" in drawn and "Right Eye" in drawn


def test_regions_show_the_paint_buttons_and_the_findings_of_the_check():
    head = add_head(bpy.context)
    assert FACEMIME_PT_regions.poll(bpy.context)
    assert "facemime.paint_region" in draw(FACEMIME_PT_regions)
    head.vertex_groups[REGION_GROUPS[0]].remove(range(len(head.data.vertices)))
    head.vertex_groups[REGION_GROUPS[0]].add([0], 1.0, "REPLACE")
    bpy.ops.facemime.check_head()
    assert "none of its control points" in draw(FACEMIME_PT_regions)
    bpy.ops.facemime.propose_regions()
    bpy.ops.facemime.check_head()
    assert "Ready" in draw(FACEMIME_PT_regions)
    bpy.ops.facemime.paint_region(region="LOWER")
    assert "facemime.leave_painting" in draw(FACEMIME_PT_regions)


@pytest.mark.parametrize(
    ("panel", "expected"),
    [
        (FACEMIME_PT_start, "facemime.add_head"),
        (FACEMIME_PT_expression, "kernel"),
        (FACEMIME_PT_source, "speed"),
        (FACEMIME_PT_calibration, "facemime.calibrate"),
        (FACEMIME_PT_puppet, "mirror"),
        (FACEMIME_PT_pose, "rotation_limit"),
        (FACEMIME_PT_bake, "facemime.puppet_video"),
    ],
)
def test_every_panel_draws(panel, expected):
    assert expected in draw(panel)


def test_the_box_on_top_leads_from_no_head_to_start_and_names_the_head():
    cube()
    assert "facemime.add_head" in draw(FACEMIME_PT_start) and "facemime.bind_landmarks" in draw(FACEMIME_PT_start)
    head = add_head(bpy.context)
    assert "facemime.puppet" in draw(FACEMIME_PT_start) and head.name in draw(FACEMIME_PT_start)
    head.select_set(False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
    assert head.name in draw(FACEMIME_PT_start), "the only head there is can be driven, whatever is selected"


@pytest.mark.parametrize(
    ("kind", "prop", "step"),
    [("VIDEO", "video", "the video"), ("PICTURES", "folder", "the folder"), ("TAKE", "take", "the take")],
)
def test_the_box_on_top_asks_for_the_file_of_the_source_before_reporting_ready(kind, prop, step):
    add_head(bpy.context)
    source = bpy.context.scene.facemime.source
    source.kind = kind
    assert f"Choose {step} above" in draw(FACEMIME_PT_start) and "Ready" not in draw(FACEMIME_PT_start)
    setattr(source, prop, "mine")
    assert "Choose" not in draw(FACEMIME_PT_start)
    assert ("Track and Bake" if kind == "VIDEO" else "Ready") in draw(FACEMIME_PT_start)


def test_the_box_on_top_says_why_a_puppet_could_not_start_until_the_source_is_changed():
    add_head(bpy.context)
    source = bpy.context.scene.facemime.source
    source.kind, source.take = "TAKE", "/none.facetake"
    assert "Ready" in draw(FACEMIME_PT_start)
    with pytest.raises(RuntimeError):
        bpy.ops.facemime.puppet()
    drawn = draw(FACEMIME_PT_start)
    assert "Ready" not in drawn and "none.facetake" in drawn
    source.take = "/other.facetake"
    assert "Ready" in draw(FACEMIME_PT_start)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux lists its cameras")
def test_the_box_on_top_is_not_ready_with_a_camera_that_is_not_there():
    add_head(bpy.context)
    bpy.context.scene.facemime.source.kind = "CAMERA"
    preferences().camera = "63"
    drawn = draw(FACEMIME_PT_start)
    preferences().property_unset("camera")
    assert "No camera 63" in drawn and "Ready" not in drawn


def test_the_box_on_top_offers_the_keys_of_a_character_before_its_face():
    head = add_head(bpy.context, units=True)
    for child in list(head.children):
        bpy.data.objects.remove(child)
    for key in list(head.data.keys()):
        del head.data[key]
    drawn = draw(FACEMIME_PT_start)
    assert "Use Its 51 ARKit Keys" in drawn and head.name in drawn
    assert drawn.index("facemime.bind_keys") < drawn.index("facemime.bind_landmarks")
    assert bpy.ops.facemime.bind_keys() == {"FINISHED"}
    assert "facemime.puppet" in draw(FACEMIME_PT_start)


def test_the_box_on_top_shows_the_next_steps_after_a_recording(session, takes):
    assert bpy.ops.facemime.record_take(name="First") == {"FINISHED"}
    wait_for(lambda: session.recorder.recording.frames > 3)
    assert "facemime.bake_take" not in draw(FACEMIME_PT_start)
    assert bpy.ops.facemime.record_take() == {"FINISHED"}
    drawn = draw(FACEMIME_PT_start)
    assert all(f"facemime.{step}_take" in drawn for step in ("show", "trim", "bake")) and "First" in drawn
    session.close()
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    assert "facemime.bake_take" not in draw(FACEMIME_PT_start)


def test_a_selected_part_stands_for_its_head():
    head = add_head(bpy.context)
    other = add_head(bpy.context)
    bpy.context.window_manager.facemime_picked = head.children[0]
    assert bpy.context.view_layer.objects.active == head and not other.select_get()
    assert bpy.context.window_manager.facemime_picked is None


# Of lists, dialogs and sessions: they have no meaning without the row or the session that they belong to.
_ELSEWHERE = frozenset(
    ("add_key_row", "remove_key_row", "mark_point", "set_part", "add_part", "remove_part", "set_bone", "choose_camera")
    + ("accept_points", "discard_points")
)


def reachable(menu: type) -> set[str]:
    """Return the operators of a menu and of its submenus."""
    layout = Layout()
    menu.draw(SimpleNamespace(layout=layout, entries=getattr(menu, "entries", ())), bpy.context)
    found = {call[1].removeprefix("facemime.") for call in layout.calls if call[0].startswith("operator") and call[1:]}
    submenus = (getattr(bpy.types, call[1]) for call in layout.calls if call[0] == "menu")
    return found.union(*(reachable(each) for each in submenus))


def test_the_menu_reaches_every_operator():
    add_head(bpy.context)
    everything = {
        kind.bl_idname.removeprefix("facemime.")
        for kind in bpy.types.Operator.__subclasses__()
        if kind.__name__.startswith("FACEMIME_OT_") and "INTERNAL" not in getattr(kind, "bl_options", set())
    }
    found = reachable(VIEW3D_MT_facemime)
    assert found | {"remove_preset"} >= everything - _ELSEWHERE, "that menu is there once there is a preset to remove"
    for name in found:
        assert hasattr(bpy.types, f"FACEMIME_OT_{name}"), name


def test_the_two_calibration_buttons_tell_the_performer_what_to_do():
    told = {pose: calibration_tooltip(pose) for pose in ("NEUTRAL", "RANGE")}
    assert "relaxed face" in told["NEUTRAL"] and "close the eyes tightly" in told["RANGE"]


def calibration_tooltip(pose: str) -> str:
    return FACEMIME_OT_calibrate.description(bpy.context, SimpleNamespace(pose=pose))


def test_everything_that_the_panels_draw_exists():
    head = add_head(bpy.context)
    write_selection(head.data, select_control_points(read_rig(head), performance(), max_points=12))
    layout = Layout()
    for panel in bpy.types.Panel.__subclasses__():
        if not panel.__name__.startswith("FACEMIME"):
            continue
        panel.draw(SimpleNamespace(layout=layout), bpy.context)
    operators = {call[1] for call in layout.calls if call[0] == "operator"}
    for name in operators:
        assert hasattr(bpy.types, f"FACEMIME_OT_{name.split('.')[1]}"), name
    assert {call[0] for call in layout.calls} <= set(bpy.types.UILayout.bl_rna.functions.keys())


def test_takes_and_the_key_table_are_listed_with_their_operators(tmp_path):
    head = add_head(bpy.context, units=True)
    assert "Record a take" in draw(FACEMIME_PT_takes)
    save_take(performance(), tmp_path / "Anna.facetake")
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "Anna.facetake"))
    takes = bpy.context.scene.facemime_takes
    takes.items[0].note, takes.items[0].star = "the second smile", True
    bpy.ops.facemime.pack_take()
    for operator in ("show_take", "trim_take", "mend_take", "remove_take"):
        assert f"facemime.{operator}" in draw(FACEMIME_PT_takes)
    for operator in ("punch_in_take", "add_sound", "take_from_animation", "renew_neutral"):
        assert f"facemime.{operator}" in draw(FACEMIME_MT_takes)
    assert "Unpack Take" in draw(FACEMIME_MT_takes) and "in your documents" in draw(FACEMIME_PT_takes)
    bpy.ops.facemime.detect_key_map()
    assert "key_blocks" in draw(FACEMIME_PT_key_map)
    bpy.context.view_layer.objects.active = head.children[0]
    bpy.ops.object.select_all(action="DESELECT")
    assert "facemime.learn_key_map" in draw(FACEMIME_PT_key_map) and "max_keys" in draw(FACEMIME_PT_take_bake)
    layout = Layout()
    FACEMIME_UL_takes.draw_row(None, bpy.context, layout, takes.items[0], 0)
    assert "0:02.4" in layout.texts() and "PACKAGE" in layout.texts()
    FACEMIME_UL_key_rows.draw_row(None, bpy.context, layout, takes.bake.rows[0], 0)
    assert takes.bake.rows[0].source in layout.texts() and "gain" in draw(FACEMIME_PT_key_map)
