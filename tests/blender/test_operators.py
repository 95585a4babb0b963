"""Operators do the same as the functions behind them, and report errors."""

import importlib.util
import subprocess
import sys
from inspect import get_annotations
from pathlib import Path
from types import FunctionType

import bpy
import numpy as np
import pytest
from mathutils import Vector

import facemime
from facemime import registration
from facemime.blender.animation.puppet import puppet_head
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_vertices
from facemime.blender.registering import classes_of
from facemime.core.heads.built_in import WOMAN_FILE, load_head
from facemime.core.takes.file import load_take, save_take
from facemime.operators.puppet_video import FACEMIME_OT_puppet_video
from facemime.sessions.session import Session
from facemime.sessions.tracking import TrackingSession
from facemime.settings import storage
from facemime.settings.values import SAMPLE as SHIPPED
from facemime.settings.values import whole_file
from tests.helpers.blenders import ROOT
from tests.helpers.takes import performance

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


def key_coordinates(obj: bpy.types.Object) -> np.ndarray:
    """Return (K, 3 V) coordinates of all shape keys."""
    rows = []
    for key in obj.data.shape_keys.key_blocks:
        row = np.empty(3 * len(obj.data.vertices), np.float32)
        key.points.foreach_get("co", row)
        rows.append(row)
    return np.array(rows)


def test_registering_unregistering_and_registering_again_works():
    facemime.unregister()
    assert not hasattr(bpy.types.Scene, "facemime")
    facemime.register()
    assert bpy.context.scene.facemime.rotation


def test_a_second_copy_of_the_extension_is_refused_and_leaves_the_first_one_working():
    found = importlib.util.spec_from_file_location("facemime_again", ROOT / "__init__.py")
    again = sys.modules["facemime_again"] = importlib.util.module_from_spec(found)
    found.loader.exec_module(again)
    with pytest.raises(RuntimeError, match=r"Another copy of Facemime is enabled: facemime\. Disable that one"):
        again.register()
    assert bpy.ops.facemime.add_head() == {"FINISHED"}
    facemime.unregister()
    try:
        again.register()
        with pytest.raises(RuntimeError, match="enabled: facemime_again"):
            facemime.register()
        again.unregister()
    finally:
        facemime.register()
        for name in [name for name in sys.modules if name.split(".")[0] == "facemime_again"]:
            del sys.modules[name]


@pytest.mark.thorough
@pytest.mark.parametrize("removed", [True, False])
def test_a_program_with_blender_as_a_module_ends_whether_or_not_it_removes_the_extension(removed):
    if not removed and not getattr(bpy.app, "module", False):
        pytest.skip("this version of Blender does not tell that it is a module")
    code = "import bpy, facemime; facemime.register()" + "; facemime.unregister()" * removed
    done = subprocess.run([sys.executable, "-c", code], timeout=120, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "Not freed" not in done.stdout + done.stderr


def test_no_function_that_a_setting_calls_keeps_blender_alive():
    """Blender 4.2 would crash when it quits."""
    groups = [cls for module in registration._MODULES for cls in classes_of(module)]
    groups = [cls for cls in groups if issubclass(cls, bpy.types.PropertyGroup)]
    hints = [hint for group in groups for hint in get_annotations(group).values()]
    called = {value for hint in hints for value in hint.keywords.values() if isinstance(value, FunctionType)}
    assert called and not [function for function in called if bpy in function.__globals__.values()]


def test_add_head_adds_the_head_at_the_3d_cursor():
    bpy.context.scene.cursor.location = (1.0, 2.0, 3.0)
    assert bpy.ops.facemime.add_head() == {"FINISHED"}
    head = bpy.context.active_object
    assert len(head.data.vertices) == 1781 and tuple(head.location) == (1.0, 2.0, 3.0)


def test_the_female_head_is_added_if_chosen():
    assert bpy.ops.facemime.add_head(person="WOMAN") == {"FINISHED"}
    woman = bpy.context.active_object
    rest = read_vertices(woman.data)
    assert np.allclose(rest, load_head(WOMAN_FILE).vertices, atol=1e-6)
    assert not np.allclose(rest, load_head().vertices, atol=1e-3)


def test_a_head_is_added_beside_objects_at_the_cursor_in_a_separate_collection():
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    cube = bpy.context.active_object
    bpy.ops.mesh.primitive_uv_sphere_add(radius=100.0)
    heads = []
    for _ in range(2):
        bpy.ops.facemime.add_head()
        heads.append(bpy.context.active_object)
    bpy.context.view_layer.update()
    reach = [[(obj.matrix_world @ Vector(corner)).x for corner in obj.bound_box] for obj in (cube, *heads)]
    assert max(reach[0]) < min(reach[1]) and max(reach[1]) < min(reach[2])
    for head in heads:
        assert head.location.y == head.location.z == 0.0
        assert set(head.users_collection[0].objects) == {head, *head.children}


def test_the_operator_and_the_function_agree(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    bpy.ops.facemime.add_head()
    by_operator = bpy.context.active_object
    assert bpy.ops.facemime.puppet_video(filepath=str(tmp_path / "take.facetake")) == {"FINISHED"}
    by_function = add_head(bpy.context)
    puppet_head(bpy.context.scene, by_function, load_take(tmp_path / "take.facetake"))
    np.testing.assert_allclose(key_coordinates(by_operator), key_coordinates(by_function), atol=1e-6)


def test_the_settings_of_the_scene_are_used(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    bpy.ops.facemime.add_head()
    head = bpy.context.active_object
    settings = bpy.context.scene.facemime
    settings.rotation = False
    settings.strength_lower = settings.strength_middle = settings.strength_upper = 0.0
    bpy.ops.facemime.puppet_video(filepath=str(tmp_path / "take.facetake"))
    assert head.animation_data is None
    assert max(key.value for key in head.data.shape_keys.key_blocks[1:]) < 1e-3


@pytest.mark.parametrize("name", ["missing.mp4", "missing.facetake", "broken.mp4", "broken.facetake"])
def test_a_file_that_cannot_be_read_is_reported_and_changes_nothing(tmp_path, name):
    (tmp_path / "broken.mp4").write_bytes(b"nothing")
    (tmp_path / "broken.facetake").write_bytes(b"nothing")
    bpy.ops.facemime.add_head()
    with pytest.raises(RuntimeError, match=name.split(".")[0]):
        bpy.ops.facemime.puppet_video(filepath=str(tmp_path / name))
    assert bpy.context.active_object.data.shape_keys is None
    assert Session.current is None


def test_the_operator_reports_what_a_damaged_take_lacks(tmp_path, capfd):
    path = tmp_path / "take.facetake"
    save_take(performance(), path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    add_head(bpy.context)
    assert bpy.ops.facemime.puppet_video(filepath=str(path)) == {"FINISHED"}
    assert "The file was cut or damaged. Missing: " in capfd.readouterr().out


def test_a_mesh_without_landmarks_is_reported(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    bpy.ops.mesh.primitive_cube_add()
    with pytest.raises(RuntimeError, match="Select a head"):
        bpy.ops.facemime.puppet_video(filepath=str(tmp_path / "take.facetake"))


def test_without_a_mesh_the_button_is_disabled():
    assert not FACEMIME_OT_puppet_video.poll(bpy.context)


def test_a_stopped_session_keeps_the_tracked_frames():
    session = TrackingSession(SAMPLE)
    while session.tracking and session.done < 5:
        pass
    session.stop()
    take = session.take()
    assert 5 <= len(take) < 100 and take.info["interrupted"]
    session.close()
    session.close()
    assert Session.current is None


def test_loading_a_file_ends_the_session():
    session = TrackingSession(SAMPLE)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert not session.tracking and Session.current is None


def test_a_take_moves_all_selected_heads(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    first = add_head(bpy.context, name="First")
    second = add_head(bpy.context, name="Second")
    first.select_set(True)
    assert bpy.ops.facemime.puppet_video(filepath=str(tmp_path / "take.facetake")) == {"FINISHED"}
    np.testing.assert_allclose(key_coordinates(first), key_coordinates(second), atol=1e-6)


@pytest.mark.parametrize("operator", ["export_preset", "import_preset", "export_key_map", "import_take"])
@pytest.mark.parametrize("name", ["", "folder/", "folder"])
def test_confirming_the_file_browser_without_a_name_is_reported(operator, name, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(RuntimeError, match="No file was selected"):
        getattr(bpy.ops.facemime, operator)(filepath=name and str(tmp_path / name))
    assert [path.name for path in tmp_path.rglob("*")] == ["folder"]


def test_an_impossible_bake_is_reported_before_tracking(monkeypatch):
    monkeypatch.setattr(TrackingSession, "__init__", lambda *_: pytest.fail("it was tracked"))
    add_head(bpy.context, units=True).data.shape_keys.use_relative = False
    with pytest.raises(RuntimeError, match="are absolute"):
        bpy.ops.facemime.puppet_video(filepath=str(SAMPLE))


def test_the_tracked_take_is_kept_if_it_cannot_be_baked(tmp_path, monkeypatch):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "project.blend"))
    head, settings = add_head(bpy.context), bpy.context.scene.facemime
    settings.find_neutral, settings.neutral = False, 99.0
    monkeypatch.setattr(TrackingSession, "take", lambda session: performance())
    with pytest.raises(RuntimeError, match=r"Choose another neutral\. The tracked take is in the list as sample"):
        bpy.ops.facemime.puppet_video(filepath=str(SAMPLE))
    (line,) = bpy.context.scene.facemime_takes.items
    assert line.name == "sample" and line.length == pytest.approx(performance().times[-1])
    assert len(load_take(tmp_path / "takes" / "sample.facetake")) == len(performance())
    assert Session.current is None and head.data.shape_keys is None


def test_tracking_and_baking_a_video_leaves_a_take(tmp_path, monkeypatch):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "project.blend"))
    head = add_head(bpy.context)
    monkeypatch.setattr(TrackingSession, "take", lambda session: performance())
    assert bpy.ops.facemime.puppet_video(filepath=str(SAMPLE)) == {"FINISHED"}
    (line,) = bpy.context.scene.facemime_takes.items
    assert line.name == "sample" and len(load_take(tmp_path / "takes" / "sample.facetake")) == len(performance())
    assert head.data.shape_keys.animation_data is not None


def test_a_take_that_cannot_be_written_is_baked_nevertheless(tmp_path, monkeypatch):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "project.blend"))
    (tmp_path / "takes").write_text("a file where the folder should be")
    monkeypatch.setattr(storage, "default_folder", lambda name: tmp_path / name)
    head = add_head(bpy.context)
    monkeypatch.setattr(TrackingSession, "take", lambda session: performance())
    bpy.ops.facemime.puppet_video(filepath=str(SAMPLE))
    assert len(bpy.context.scene.facemime_takes.items) == 0
    assert head.data.shape_keys.animation_data is not None


def test_whole_video_offers_the_file_chosen_as_source():
    source = bpy.context.scene.facemime.source
    assert whole_file(source) == str(SHIPPED)
    source.kind = "CAMERA"
    assert whole_file(source) == ""
    source.kind, source.video = "VIDEO", "/clips/mine.mp4"
    assert whole_file(source) == "/clips/mine.mp4"
