"""Teaching a head by examples: in a preview, in a live session, in bakes, and as a file."""

import bpy
import numpy as np
import pytest

from facemime.blender.animation.live_mesh import LIVE_KEY
from facemime.blender.heads.new_heads import add_head
from facemime.blender.names import VALUES_PROPERTY
from facemime.blender.rigs import read_rig
from facemime.core.heads.style import load_style
from facemime.core.heads.thumbnail import pixels_of
from facemime.core.takes.file import save_take
from facemime.sessions.session import Session
from facemime.sessions.show import TakeShow, follow_settings
from facemime.sessions.start import follow_settings as follow_live_settings
from facemime.sessions.start import start_session
from facemime.ui.teaching import picture_of
from tests.blender.test_cli import run
from tests.blender.test_live_keys import character
from tests.helpers.live_ticks import shown, wait_for
from tests.helpers.takes import performance

EXPRESSION = 42
"""A frame with an open mouth and raised brows."""
_CONTACT = 5e-4
"""How far lids that were taught to enter an eye are pushed out of it, in metres."""


@pytest.fixture(autouse=True)
def _resting_at_first(in_a_project):
    """Let the face be neutral in the first second, as it is in the take."""
    bpy.context.scene.facemime.find_neutral, bpy.context.scene.facemime.neutral = False, 0.0


def slider(head: bpy.types.Object, name: str) -> bpy.types.ShapeKey:
    """A shape key of a head."""
    return head.data.shape_keys.key_blocks[name]


def taught(name: str = "mouthSmileLeft", value: float = 0.8, frame: int = EXPRESSION) -> bpy.types.Object:
    """A built-in head that shows a take and was taught one frame by a slider."""
    head = add_head(bpy.context, units=True)
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    bpy.context.scene.frame_set(frame)
    slider(head, name).value = value
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    return head


def test_a_taught_frame_looks_as_it_did_with_the_slider_which_returns_to_rest(imported):
    head = add_head(bpy.context, units=True)
    bpy.ops.facemime.show_take()
    bpy.context.scene.frame_set(EXPRESSION)
    without = shown(head)
    slider(head, "mouthSmileLeft").value = 0.8
    wanted = shown(head)
    assert np.abs(wanted - without).max() > 0.01
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    assert slider(head, "mouthSmileLeft").value == 0.0
    np.testing.assert_allclose(shown(head), wanted, atol=_CONTACT)
    bpy.context.scene.frame_set(5)
    at_rest = shown(head)
    head.facemime_style.examples[0].mute = True
    follow_settings()
    np.testing.assert_allclose(shown(head), at_rest, atol=1e-6)
    bpy.ops.facemime.show_take()


def test_the_weight_and_the_mute_switch_of_an_example_act_at_once(imported):
    head = taught()
    full = shown(head)
    head.facemime_style.examples[0].weight = 0.0
    follow_settings()
    none = shown(head)
    head.facemime_style.examples[0].weight = 0.5
    follow_settings()
    np.testing.assert_allclose(shown(head), (full + none) / 2.0, atol=_CONTACT)
    head.facemime_style.examples[0].mute = True
    follow_settings()
    np.testing.assert_allclose(shown(head), none, atol=_CONTACT)


def test_a_shape_that_was_sculpted_can_be_taught(imported):
    head = add_head(bpy.context)
    bpy.ops.facemime.show_take()
    bpy.context.scene.frame_set(EXPRESSION)
    points = slider(head, LIVE_KEY).points
    before = shown(head)
    chin = int(head.data["facemime_landmarks"][8])
    points[chin].co.z -= 0.1
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    moved = shown(head) - before
    assert moved[chin] == pytest.approx((0.0, 0.0, -0.1), abs=1e-5)
    assert np.abs(np.delete(moved, chin, axis=0)).max() < 1e-5


def test_an_unchanged_frame_and_a_face_at_rest_are_refused_with_what_to_do(imported, capfd):
    head = add_head(bpy.context)
    assert not bpy.ops.facemime.teach_frame.poll()
    bpy.ops.facemime.show_take()
    bpy.context.scene.frame_set(EXPRESSION)
    with pytest.raises(RuntimeError, match=r"looks as the take shows it.*Make Expression Keys"):
        bpy.ops.facemime.teach_frame()
    bpy.context.scene.frame_set(5)
    slider(head, LIVE_KEY).points[0].co.z += 0.1
    with pytest.raises(RuntimeError, match=r"at rest in this frame"):
        bpy.ops.facemime.teach_frame()
    assert not len(head.facemime_style.examples)


@pytest.mark.parametrize("name", ["Facemime Head", "Renamed"])
def test_values_that_keys_had_before_the_preview_are_not_taught(imported, name):
    head = add_head(bpy.context, units=True)
    slider(head, "cheekPuff").value = 0.3
    bpy.ops.facemime.show_take()
    head.name = name
    bpy.context.scene.frame_set(EXPRESSION)
    slider(head, "mouthSmileLeft").value, slider(head, "cheekPuff").value = 0.5, 0.5
    wanted = shown(head)
    bpy.ops.facemime.teach_frame()
    assert slider(head, "cheekPuff").value == pytest.approx(0.3)
    np.testing.assert_allclose(shown(head), wanted, atol=_CONTACT)


def test_teaching_a_frame_again_replaces_its_example_by_what_is_shown_now(imported):
    head = taught()
    slider(head, "jawOpen").value = 0.4
    wanted = shown(head)
    bpy.ops.facemime.teach_frame()
    assert len(head.facemime_style.examples) == 1
    np.testing.assert_allclose(shown(head), wanted, atol=_CONTACT)


def test_the_keys_that_drive_a_head_are_taught_even_those_outside_the_mapping(imported):
    head, scene = character(), bpy.context.scene
    head.shape_key_add(name="Dimple", from_mix=False).value = 0.0
    slider(head, "Dimple").points[3].co.z += 0.2
    bpy.ops.facemime.show_take()
    scene.frame_set(EXPRESSION)
    slider(head, "mouthSmileLeft").value, slider(head, "Dimple").value = 0.7, 0.6
    assert bpy.ops.facemime.teach_frame() == {"FINISHED"}
    assert set(load_values(head)) == {"mouthSmileLeft", "Dimple"}
    assert (slider(head, "mouthSmileLeft").value, slider(head, "Dimple").value) == pytest.approx((0.7, 0.6), abs=1e-4)
    scene.frame_set(5)
    assert slider(head, "Dimple").value == pytest.approx(0.0, abs=1e-4)
    bpy.ops.facemime.show_take()
    assert slider(head, "Dimple").value == 0.0 and VALUES_PROPERTY not in head.data.shape_keys
    scene.facemime.smoothing = 0.0
    bpy.ops.facemime.bake_take()
    scene.frame_set(EXPRESSION)
    assert (slider(head, "mouthSmileLeft").value, slider(head, "Dimple").value) == pytest.approx((0.7, 0.6), abs=0.05)


def load_values(head: bpy.types.Object) -> dict[str, float]:
    """The keys of the only example of a head."""
    (example,) = read_rig(head).style.examples
    return dict(example.keys)


def test_a_bake_contains_what_was_taught(imported):
    head, scene = taught(), bpy.context.scene
    wanted = shown(head)
    bpy.ops.facemime.show_take()
    scene.facemime_takes.bake.keys = "new"
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    scene.frame_set(EXPRESSION)
    assert np.abs(shown(head) - wanted).max() < 0.02 * read_rig(head).eye_distance


def test_a_style_is_undone_saved_and_copied_with_the_head(imported, tmp_path):
    head, name = taught(), "Facemime Head"
    bpy.ops.ed.undo_push(message="Teach This Frame")
    slider(head, "jawOpen").value = 0.5
    bpy.context.scene.frame_set(EXPRESSION + 8)
    slider(head, "jawOpen").value = 0.5
    bpy.ops.facemime.teach_frame()
    bpy.ops.ed.undo_push(message="Teach This Frame")
    assert len(head.facemime_style.examples) == 2
    bpy.ops.ed.undo()
    head = bpy.data.objects[name]
    assert len(head.facemime_style.examples) == 1 and isinstance(Session.current, TakeShow)
    bpy.context.scene.frame_set(EXPRESSION)
    wanted = shown(head)
    bpy.ops.facemime.show_take()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "taught.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "taught.blend"))
    head = bpy.data.objects[name]
    bpy.ops.facemime.show_take()
    bpy.context.scene.frame_set(EXPRESSION)
    np.testing.assert_allclose(shown(head), wanted, atol=_CONTACT)
    assert pixels_of(read_rig(head).style.examples[0].thumbnail) is not None
    assert picture_of(head.facemime_style.examples[0]) >= 0


def test_a_style_is_shared_as_a_file_between_copies_of_a_head(imported, tmp_path):
    head, path = taught(), tmp_path / "artist.facestyle"
    wanted = shown(head)
    bpy.ops.facemime.show_take()
    assert bpy.ops.facemime.save_style(filepath=str(path.with_suffix(""))) == {"FINISHED"}
    assert bpy.ops.facemime.remove_example() == {"FINISHED"} and not bpy.ops.facemime.save_style.poll()
    assert bpy.ops.facemime.load_style(filepath=str(path)) == {"FINISHED"}
    assert [example.name for example in load_style(path).examples] == [head.facemime_style.examples[0].name]
    bpy.ops.facemime.show_take()
    bpy.context.scene.frame_set(EXPRESSION)
    np.testing.assert_allclose(shown(head), wanted, atol=_CONTACT)


def test_a_style_of_another_mesh_and_a_damaged_one_are_refused(imported, tmp_path, scan):
    head, path = taught(), tmp_path / "artist.facestyle"
    bpy.ops.facemime.show_take()
    bpy.ops.facemime.save_style(filepath=str(path))
    bpy.context.view_layer.objects.active = scan
    with pytest.raises(RuntimeError, match="was taught on a mesh with"):
        bpy.ops.facemime.load_style(filepath=str(path))
    assert not len(scan.facemime_style.examples)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(RuntimeError, match="cannot be read"):
        bpy.ops.facemime.load_style(filepath=str(path))
    head.facemime_style.examples[0].data = "damaged"
    bpy.context.view_layer.objects.active = head
    with pytest.raises(RuntimeError, match="is damaged"):
        bpy.ops.facemime.show_take()


@pytest.mark.thorough
def test_the_command_uses_the_style_of_a_head_and_that_of_a_file(imported, tmp_path):
    head, style, blend = taught(), tmp_path / "artist.facestyle", tmp_path / "taught.blend"
    wanted = shown(head)
    bpy.ops.facemime.show_take()
    save_take(performance(), tmp_path / "take.facetake")
    bpy.ops.facemime.save_style(filepath=str(style))
    bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True)
    bpy.ops.facemime.remove_example()
    plain = tmp_path / "plain.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(plain), copy=True)
    for options in (("--head", f"{blend}:{head.name}"), ("--head", f"{plain}:{head.name}", "--style", style)):
        out = tmp_path / "out.blend"
        line = ("puppet", tmp_path / "take.facetake", "-o", out, "--neutral", "0", "--keys", "new", *options)
        done = run(*line)
        assert done.returncode == 0, done.stderr
        bpy.ops.wm.open_mainfile(filepath=str(out))
        bpy.context.scene.frame_set(EXPRESSION)
        moved = bpy.data.objects["Facemime Head"]
        assert np.abs(shown(moved) - wanted).max() < 0.02 * read_rig(moved).eye_distance
        assert len(moved.facemime_style.examples) == 1
    done = run(*line[:-1], tmp_path / "take.facetake")
    assert done.returncode == 1 and "cannot be read" in done.stderr


def test_a_running_puppet_follows_its_examples(imported, looping):
    head, scene = taught(), bpy.context.scene
    bpy.ops.facemime.show_take()
    session = start_session(scene, [head])
    wait_for(lambda: session.step() and len(session.shown.heads) and session.shown.heads[0].taught.max() > 0.5)
    head.facemime_style.examples[0].mute = True
    follow_live_settings(session, scene)
    wait_for(lambda: session.step() and len(session.shown.heads) and not len(session.shown.heads[0].taught))
    session.close()


def test_suggested_frames_are_visited_in_turn_and_not_once_they_are_taught(imported, capfd):
    head, scene = add_head(bpy.context, units=True), bpy.context.scene
    bpy.ops.facemime.show_take()
    visited = []
    for _ in range(4):
        bpy.ops.facemime.suggest_frames(count=3)
        visited.append(scene.frame_current)
    assert len(set(visited[:3])) == 3 and visited[3] == visited[0] and "of 3" in capfd.readouterr().out
    slider(head, "jawOpen").value = 0.5
    bpy.ops.facemime.teach_frame()
    for _ in range(4):
        bpy.ops.facemime.suggest_frames(count=3)
        assert scene.frame_current != visited[0]


def test_a_bake_by_a_mapping_contains_what_was_taught_by_sliders_on_the_skin(imported):
    head = taught()
    bpy.ops.facemime.show_take()
    bake = bpy.context.scene.facemime_takes.bake
    bake.keys = "mapped"

    def baked() -> float:
        assert bpy.ops.facemime.bake_take() == {"FINISHED"}
        bpy.context.scene.frame_set(EXPRESSION)
        return slider(head, "mouthSmileLeft").value

    corrected = baked()
    head.facemime_style.examples[0].mute = True
    assert corrected - baked() == pytest.approx(0.8, abs=0.05)
