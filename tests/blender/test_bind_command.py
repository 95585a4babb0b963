"""The command `bind`: doubtful faces, points of the face, and messages for who has no window."""

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from facemime.blender.fcurves import curves_in
from facemime.blender.frames import to_blender
from facemime.blender.heads.binding import read_marks
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks, read_vertices, write_landmarks
from facemime.blender.preview_scene import face_points
from facemime.cli.bind import DOUBTFUL, parse_mark
from facemime.cli.character import BoundCharacter, bind, mark_points
from facemime.cli.console import REMEDIES, for_terminal
from facemime.core.errors import FacemimeError, HeadError
from facemime.core.face.landmarks import EYE_LEFT, EYE_RIGHT, from_ibug, outer_eye_distance
from facemime.core.heads.bind import MARKS, TOO_COARSE, Binding
from facemime.core.heads.built_in import load_head
from facemime.core.puppet.job import HeadFile
from facemime.core.takes.file import save_take
from lab.training.data import DATA
from tests.helpers.bakes import armature
from tests.helpers.blenders import ROOT
from tests.helpers.commands import run
from tests.helpers.face_rigs import make_face_rig
from tests.helpers.takes import performance

CHARACTERS = DATA / "characters"
LIDS = np.concatenate([EYE_RIGHT, EYE_LEFT])


@pytest.fixture
def plain():
    """The skin of the built-in head, as a stranger's mesh that is not at the origin, and where its landmarks are."""
    head = add_head(bpy.context)
    head.name = "Face"
    places = read_vertices(head.data)[read_landmarks(head)]
    for child in head.children:
        bpy.data.objects.remove(child)
    for owner in (head, head.data):
        for key in list(owner.keys()):
            del owner[key]
    head.vertex_groups.clear()
    head.location = (0.5, 0.0, 1.6)
    bpy.context.view_layer.update()
    return head, places


def in_scene(head, places):
    matrix = np.array(head.matrix_world)
    return to_blender(places) @ matrix[:3, :3].T + matrix[:3, 3]


def distorted(head, places):
    """Move the mouth onto the nose, as on an ogre."""
    points = read_vertices(head.data).astype(float)
    unit = outer_eye_distance(places)
    mouth = places[from_ibug([48, 54])].mean(axis=0)
    near = np.exp(-np.square(np.linalg.norm(points - mouth, axis=1) / (0.45 * unit)))
    points[:, 1] -= 0.3 * unit * near
    points[:, 0] *= 1.0 + 0.8 * near
    for vertex, place in zip(head.data.vertices, to_blender(points), strict=True):
        vertex.co = place
    return points


def test_points_are_marked_by_vertex_or_by_position_in_the_scene(plain):
    head, places = plain
    wanted = {number: places[from_ibug([number])[0]] for number in MARKS}
    marks = {number: tuple(in_scene(head, place[None])[0]) for number, place in wanted.items()}
    other = bpy.data.objects.new("Box", bpy.data.meshes.new("Box"))
    bpy.context.scene.collection.objects.link(other)
    assert mark_points(head, marks) == head
    found = read_marks(head.data)
    for number, place in wanted.items():
        np.testing.assert_allclose(read_vertices(head.data)[found[number]], place, atol=1e-5)
    assert mark_points(head, {8: 17}) == head and read_marks(head.data) == {8: 17}
    with pytest.raises(HeadError, match="Point 8 cannot be vertex 99999: Face has 1781 vertices"):
        mark_points(head, {8: 99999})
    with pytest.raises(HeadError, match=r"Point 8 is .* m away from Face"):
        mark_points(head, {8: (0.0, 9.0, 0.0)})


@pytest.mark.parametrize(("hidden", "levels"), [(False, 0), (True, 0), (False, 1)])
def test_positions_are_those_that_are_seen_in_the_pose(plain, hidden, levels):
    head, _ = plain
    landmarks = load_head().landmarks
    rig = armature("Head")
    head.vertex_groups.new(name="Head").add(range(len(head.data.vertices)), 1.0, "REPLACE")
    if levels:
        head.modifiers.new("Subdivision", "SUBSURF").levels = levels
    head.modifiers.new("Armature", "ARMATURE").object = rig
    moved = Matrix.Translation((0.0, 0.0, 4.0)) @ Matrix.Rotation(0.3, 4, "X")
    rig.pose.bones["Head"].matrix = moved @ rig.data.bones["Head"].matrix_local
    bpy.context.view_layer.update()
    rest = np.array([tuple(vertex.co) for vertex in head.data.vertices])[landmarks]
    turn = np.array(Matrix.Rotation(0.3, 3, "X"))
    seen = (rest + np.array(head.location)) @ turn.T + [0.0, 0.0, 4.0]
    head.hide_set(hidden)
    shown = [modifier.show_viewport for modifier in head.modifiers]
    numbers = (8, 30, 36, 45)
    wanted = {number: tuple(seen[from_ibug([number])[0]]) for number in numbers}
    assert mark_points(head, wanted) == head
    assert read_marks(head.data) == {number: landmarks[from_ibug([number])[0]] for number in numbers}
    write_landmarks(head.data, landmarks)
    binding = Binding(landmarks, np.eye(3), 0.0, 0.1, False, False, 0.6, numbers)
    printed = dict(parse_mark(word) for word in BoundCharacter(head, binding, []).doubt().split() if word[0].isdigit())
    for number, place in wanted.items():
        np.testing.assert_allclose(printed[number], place, atol=1e-4)
    assert [modifier.show_viewport for modifier in head.modifiers] == shown
    assert head.hide_get() == hidden


@pytest.mark.thorough
@pytest.mark.skipif(not CHARACTERS.is_dir(), reason="the characters of ../shared/data are not here")
@pytest.mark.parametrize("name", ["rigged", "vroid", "scan"])
def test_the_own_points_of_a_character_given_as_marks_keep_its_landmarks(name):
    file = HeadFile(CHARACTERS / f"{name}.glb")
    bound = bind(file, keys=None)
    before = read_landmarks(bound.head)
    places = face_points(bound.head)[before]
    for numbers in (tuple(MARKS), (8, 30, 48, 54), (36, 39, 42, 45)):
        again = bind(file, keys=None, marks={n: tuple(places[from_ibug([n])[0]].tolist()) for n in numbers})
        after = face_points(again.head)[read_landmarks(again.head)]
        np.testing.assert_allclose(after, places, atol=1e-6)


@pytest.mark.parametrize("text", ["", "8", "8=", "5=3", "8=1,2", "8=nan,0,0", "8=1.5", "x=1"])
def test_a_point_that_cannot_be_understood_is_reported(text):
    with pytest.raises(FacemimeError, match="is not a point of a face"):
        parse_mark(text)
    assert parse_mark("8=12") == (8, 12) and parse_mark("45=0.1,-2e-1,1") == (45, (0.1, -0.2, 1.0))


@pytest.mark.thorough
def test_a_doubtful_face_is_said_and_marks_settle_it(plain, tmp_path):
    head, places = plain
    distorted(head, places)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ogre.blend"))
    done = run("bind", tmp_path / "ogre.blend", "-o", tmp_path / "out.blend")
    assert done.returncode == DOUBTFUL and (tmp_path / "out.blend").is_file()
    assert "This face is unusual. If landmarks are misplaced, mark four points: " in done.stderr
    options = [part for part in done.stderr.split() if part.startswith(tuple(f"{number}=" for number in MARKS))]
    assert len(options) == 4
    marks = [word for option in options for word in ("--mark", option)]
    done = run("bind", tmp_path / "ogre.blend", "-o", tmp_path / "out.blend", *marks)
    assert done.returncode == 0 and "unusual" not in done.stderr


@pytest.mark.parametrize("marked", [False, True])
def test_a_mesh_that_is_too_coarse_says_that_it_has_to_be_subdivided(plain, marked):
    head, places = plain
    head.modifiers.new("Decimate", "DECIMATE").ratio = 0.1
    with bpy.context.temp_override(object=head):
        bpy.ops.object.modifier_apply(modifier="Decimate")
    if marked:
        mark_points(head, {n: tuple(in_scene(head, places[from_ibug([n])])[0]) for n in MARKS})
    with pytest.raises(RuntimeError, match="Subdivide the face"):
        bpy.ops.facemime.bind_landmarks()
    assert "Subdivide" in TOO_COARSE


@pytest.mark.thorough
def test_errors_of_the_command_name_options_and_no_buttons(tmp_path):
    bpy.ops.mesh.primitive_torus_add(major_segments=40, minor_segments=20)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "torus.blend"))
    done = run("bind", tmp_path / "torus.blend", "-o", tmp_path / "out.blend")
    assert done.returncode == 1 and "--mark 36=" in done.stderr and "Mark the corners" not in done.stderr
    add_head(bpy.context)


def test_every_remedy_of_the_window_that_is_replaced_occurs_in_a_message():
    sources = " ".join(
        path.read_text(encoding="utf-8") for folder in ("core", "blender") for path in (ROOT / folder).rglob("*.py")
    )
    joined = " ".join(sources.replace('"\n', "").split()).replace('f"', '"').replace(' "', "")
    for window, terminal in REMEDIES.items():
        assert window in sources or window.replace(" ", "") in joined.replace(" ", "").replace('"', ""), window
        assert for_terminal(f"Problem. {window}") == f"Problem. {terminal}"


@pytest.mark.thorough
def test_controls_are_learnt_by_bind_and_animated_by_puppet(tmp_path):
    head, _ = make_face_rig()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "rig.blend"))
    done = run("bind", f"{tmp_path / 'rig.blend'}:{head.name}", "-o", tmp_path / "learnt.blend", "--learn-controls")
    assert done.returncode == 0 and "controls found; they can show" in done.stderr
    assert "Hinge" in done.stdout and "Slider" in done.stdout
    save_take(performance(), tmp_path / "take.facetake")
    line = ("--head", tmp_path / "learnt.blend", "--keys", "controls")
    done = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "out.blend", *line)
    assert done.returncode == 0 and "controls found" not in done.stderr and "controls, largest error" in done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "out.blend"))
    assert len(curves_in(bpy.data.objects["Rig"].animation_data)) > 20


@pytest.mark.thorough
def test_puppet_learns_controls_that_are_not_known(tmp_path):
    make_face_rig()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "rig.blend"))
    save_take(performance(), tmp_path / "take.facetake")
    line = ("--head", tmp_path / "rig.blend", "--keys", "controls")
    done = run("puppet", tmp_path / "take.facetake", "-o", tmp_path / "out.blend", *line)
    assert done.returncode == 0 and "controls found" in done.stderr and "controls, largest error" in done.stderr


@pytest.mark.thorough
def test_a_character_without_a_rig_has_no_controls_to_learn(tmp_path):
    add_head(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "head.blend"))
    done = run("bind", tmp_path / "head.blend", "-o", tmp_path / "out.blend", "--learn-controls")
    assert done.returncode == 1 and "No control of Facemime Head moves its face" in done.stderr
    assert not (tmp_path / "out.blend").exists()
