"""Takes from numbered meshes and from the parameters of face models."""

import pickle
import struct
import sys
from types import ModuleType

import cv2
import numpy as np
import pytest
from scipy.sparse import csc_matrix

from facemime.core.bake.arkit import arkit_coefficients
from facemime.core.errors import SourceError
from facemime.core.face.names import COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head
from facemime.core.takes.face_models import read_moving_face
from facemime.core.takes.file import load_take
from facemime.core.takes.neutral import calibrate
from lab.training.data import DATA
from tests.helpers.commands import run
from tests.helpers.thorough import first_of

HEAD = load_head()
EYES = [part for part in HEAD.parts if part.name.startswith("eye")]
REST = np.concatenate([HEAD.vertices, *(eye.vertices for eye in EYES)]).astype(np.float64)
STARTS = np.cumsum([len(HEAD.vertices), *(len(eye.vertices) for eye in EYES)])
FACES = np.concatenate(
    [HEAD.faces, *(np.where(eye.faces < 0, -1, eye.faces + start) for eye, start in zip(EYES, STARTS, strict=False))]
)
FILE_AXES = np.array([1.0, -1.0, -1.0])
JAW_OPEN = COEFFICIENTS.index("jawOpen")
AMOUNTS = (0.0, 0.0, 0.0, 0.0, 0.2, 0.4, 0.6)
GNM = DATA / "models" / "gnm" / "gnm_landmarks.npz"


def moved(amount: float) -> np.ndarray:
    """Vertices of the head, head frame, with the mouth open by an amount, and turned by half of it to its left."""
    places = REST.copy()
    places[: len(HEAD.vertices)] += amount * HEAD.units[JAW_OPEN]
    return places @ euler_to_matrix(0.0, -amount / 2.0, 0.0).T


def write_obj(path, places):
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in places * FILE_AXES]
    lines += ["f " + " ".join(str(corner + 1) for corner in face if corner >= 0) for face in FACES.tolist()]
    path.write_text("\n".join(lines))


def write_ply(path, places, form):
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    faces = [[corner for corner in face if corner >= 0] for face in FACES.tolist()]
    header = f"ply\nformat {form} 1.0\ncomment none\nelement vertex {len(places)}\n"
    header += "property float x\nproperty float y\nproperty double z\nproperty uchar red\n"
    header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if form == "ascii":
        body = "\n".join(f"{x:.7f} {y:.7f} {z:.7f} 3" for x, y, z in places * FILE_AXES)
        body += "\n" + "\n".join(" ".join(map(str, [len(face), *face])) for face in faces) + "\n"
        path.write_text(header + body)
        return
    rows = [struct.pack(f"{order}ffdB", *place, 3) for place in (places * FILE_AXES).tolist()]
    rows += [struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces]
    path.write_bytes(header.encode() + b"".join(rows))


def check(take, amounts=AMOUNTS):
    """Check that a take opens the jaw and turns the head by the amounts."""
    seen = np.array(amounts)[take.found]
    assert arkit_coefficients(take, calibrate(take))[:, JAW_OPEN] == pytest.approx(seen, abs=0.03)
    np.testing.assert_allclose(take.pose[take.found, 2], -seen / 2.0, atol=3e-3)


@pytest.mark.thorough
def test_numbered_meshes_become_a_take(tmp_path):
    for number, amount in enumerate(AMOUNTS, 7):
        write_obj(tmp_path / f"face_{number:04}.obj", moved(amount))
    output = tmp_path / "out.facetake"
    assert run("import", tmp_path / "face_0007.obj", "-o", output, "--fps", 25).returncode == 0
    take = load_take(output)
    assert take.found.all() and np.allclose(take.times, np.arange(len(AMOUNTS)) / 25.0)
    check(take)
    assert np.isfinite(take.gaze).all()
    np.testing.assert_allclose(take.gaze, 0.0, atol=2e-3)


@pytest.mark.parametrize("form", first_of(["ascii", "binary_little_endian", "binary_big_endian"], 2))
def test_meshes_of_every_kind_of_ply_file_become_a_take(tmp_path, form):
    for number, amount in enumerate(AMOUNTS):
        write_ply(tmp_path / f"{number}.ply", moved(amount), form)
    check(read_moving_face(tmp_path, 30.0))


def test_a_missing_number_is_a_frame_without_a_face_and_is_reported(tmp_path):
    for number, amount in enumerate(AMOUNTS):
        if number != 2:
            write_obj(tmp_path / f"face{number}.obj", moved(amount))
    take = read_moving_face(tmp_path / "face0.obj", 30.0)
    assert np.flatnonzero(~take.found).tolist() == [2]
    assert take.info["notes"][0].endswith(": 1")


def test_a_mesh_with_other_vertices_is_an_error_that_names_its_file(tmp_path):
    write_obj(tmp_path / "a1.obj", REST)
    write_obj(tmp_path / "a2.obj", REST[:-1])
    with pytest.raises(SourceError, match=r"a2\.obj has \d+ vertices, and a1\.obj has \d+"):
        read_moving_face(tmp_path / "a1.obj", 30.0)


@pytest.mark.parametrize(
    "content", [b"", b"ply\nend_header\n", b"\x00" * 40, b"ply\nformat ascii 1.0\nelement vertex 9\n"]
)
def test_a_damaged_mesh_is_an_error_that_names_its_file(tmp_path, content):
    for number in (1, 2):
        (tmp_path / f"a{number}.ply").write_bytes(content)
    with pytest.raises(SourceError, match=r"a1\.ply cannot be read as a mesh"):
        read_moving_face(tmp_path, 30.0)


CHUMPY = type("Ch", (), {"__module__": "chumpy.ch", "__init__": lambda array, values: array.__dict__.update(x=values)})
"""An array of chumpy, as it is pickled."""


def flame() -> dict:
    """A model with the structure of FLAME's: the built-in head, whose only expression opens the jaw."""
    count = len(REST)
    directions = np.zeros((count, 3, 301))
    directions[: len(HEAD.vertices), :, 300] = HEAD.units[JAW_OPEN] * FILE_AXES
    regressor, weights = np.zeros((5, count)), np.zeros((count, 5))
    regressor[:3, 0] = weights[:, 0] = 1.0
    for eye, start, end in zip(EYES, STARTS[:-1], STARTS[1:], strict=True):
        joint = 3 if eye.name == "eye_left" else 4
        regressor[joint, start:end] = 1.0 / (end - start)
        weights[start:end] = np.eye(5)[joint]
    return {
        "v_template": REST * FILE_AXES,
        "shapedirs": directions,
        "posedirs": np.zeros((count, 3, 36)),
        "J_regressor": csc_matrix(regressor),
        "weights": weights,
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], dtype=np.uint32),
        "f": np.where(FACES < 0, FACES[:, :1], FACES)[:, :3].astype(np.uint32),
    }


def write_flame(path, monkeypatch):
    """Write the model as FLAME's makers do: with arrays of chumpy, which need not be installed to read it."""
    modules = {name: ModuleType(name) for name in ("chumpy", "chumpy.ch")}
    modules["chumpy.ch"].Ch = CHUMPY
    with monkeypatch.context() as context:
        for name, module in modules.items():
            context.setitem(sys.modules, name, module)
        model = {name: CHUMPY(a) if name in ("v_template", "shapedirs") else a for name, a in flame().items()}
        path.write_bytes(pickle.dumps(model, protocol=2))


def write_dense(path):
    np.savez(path, **{name: getattr(a, "toarray", lambda a=a: a)() for name, a in flame().items()})


def turned(amounts) -> np.ndarray:
    """Rotation vectors of the head, in the axes of the files."""
    return np.array([[0.0, amount / 2.0, 0.0] for amount in amounts])


@pytest.mark.thorough
@pytest.mark.parametrize(
    "names",
    [
        ("expr", "rotation", "shape"),
        ("expression", "global_orient", "betas"),
        ("exp", "pose", "shape"),
    ],
)
def test_parameters_of_flame_become_a_take(tmp_path, monkeypatch, names):
    write_flame(tmp_path / "flame.pkl", monkeypatch)
    expression, rotation, shape = names
    turns = turned(AMOUNTS)
    given = {
        expression: np.array(AMOUNTS)[:, None],
        rotation: np.concatenate([turns, np.zeros((len(turns), 3))], axis=1) if rotation == "pose" else turns,
        shape: np.zeros((1, 100)),
    }
    np.savez(tmp_path / "tracked.npz", **given)
    output = tmp_path / "out.facetake"
    done = run("import", tmp_path / "tracked.npz", "-o", output, "--model", tmp_path / "flame.pkl")
    assert done.returncode == 0
    check(load_take(output))


@pytest.mark.thorough
def test_the_joints_of_flame_turn_the_eyes_and_the_jaw_about_themselves(tmp_path):
    model = {name: getattr(a, "toarray", lambda a=a: a)() for name, a in flame().items()}
    model["weights"][: STARTS[0]] = np.eye(5)[2]  # the jaw carries all skin, and turns it as the root would
    np.savez(tmp_path / "model.npz", **model)
    turns = turned(AMOUNTS)
    eyes = np.concatenate([turns, turns], axis=1)
    np.savez(tmp_path / "clip.npz", expr=np.array(AMOUNTS)[:, None], jaw_pose=turns, eyes_pose=eyes)
    check(read_moving_face(tmp_path / "clip.npz", 30.0, tmp_path / "model.npz"))
    np.savez(tmp_path / "eyes.npz", expr=np.zeros((len(AMOUNTS), 1)), eyes_pose=eyes)
    take = read_moving_face(tmp_path / "eyes.npz", 30.0, tmp_path / "model.npz")
    np.testing.assert_allclose(take.gaze[:, 1], -np.array(AMOUNTS) / 2.0, atol=3e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("given", ["flame_param/00000.npz", "flame_param"])
def test_numbered_parameters_with_a_frame_each_become_a_take(tmp_path, monkeypatch, given):
    write_flame(tmp_path / "flame.pkl", monkeypatch)
    (tmp_path / "flame_param").mkdir()
    for number, amount in enumerate(AMOUNTS):
        if number != 1:
            row = {"expr": np.array([[amount]]), "rotation": turned([amount]), "shape": np.zeros(300)}
            np.savez(tmp_path / "flame_param" / f"{number:05}.npz", **row)
    take = read_moving_face(tmp_path / given, 30.0, tmp_path / "flame.pkl")
    assert np.flatnonzero(~take.found).tolist() == [1]
    check(take)


class Hostile:
    def __reduce__(self):
        return (exec, ("raise SystemExit('executed')",))


def write_npy(path, table):
    np.save(path, np.array(table, dtype=object), allow_pickle=True)


def spine(amounts) -> np.ndarray:
    """Joints of SMPL-X's body, which turn the head by the amounts in two steps, and the whole body much further."""
    joints = np.zeros((len(amounts), 55, 3))
    joints[:, 0] = [1.5, 0.0, 0.0]
    joints[:, 6] = joints[:, 15] = turned(amounts) / 2.0
    return joints


TURNS = turned(AMOUNTS)
OPEN = np.array(AMOUNTS)[:, None]
DOWN = np.diag([1.0, -1.0, -1.0])
IN_CAMERA = np.array([DOWN @ cv2.Rodrigues(turn)[0] for turn in TURNS])
"""The turns in the axes of a camera, whose y points down."""
WRITTEN = {
    "NeRSemble": {"expression": OPEN, "rotation": TURNS, "rotation_matrices": IN_CAMERA, "scale": np.full((1, 1), 3.0)},
    "SMIRK": {"expression_params": OPEN, "pose_params": TURNS, "jaw_params": np.zeros((len(OPEN), 3))},
    "BEAT2": {"expressions": OPEN, "poses": spine(AMOUNTS).reshape(-1, 165), "betas": np.full(300, 9.0)},
    "SMPL-X": {
        "expression": OPEN,
        "global_orient": spine(AMOUNTS)[:, 0],
        "body_pose": spine(AMOUNTS)[:, 1:22].reshape(-1, 63),
        "leye_pose": np.zeros((len(OPEN), 3)),
    },
    "in a camera": {"exp": OPEN, "pose": IN_CAMERA[:, None], "trans": np.ones((len(OPEN), 3))},
    "codes": {"expcode": OPEN, "posecode": np.pad(TURNS, ((0, 0), (0, 3))), "eyecode": np.zeros((len(OPEN), 6))},
}
"""Arrays of the same motion, by who writes them so."""


@pytest.mark.parametrize(
    ("names", "suffix"),
    [
        ("BEAT2", ".npy"),
        *(pytest.param(names, ".npz", marks=pytest.mark.thorough) for names in WRITTEN),
        pytest.param("codes", ".pkl", marks=pytest.mark.thorough),
    ],
)
def test_parameters_become_a_take_whoever_wrote_them(tmp_path, names, suffix):
    write_dense(tmp_path / "flame.npz")
    path = tmp_path / f"clip{suffix}"
    given = WRITTEN[names] | {"cam": np.zeros((len(OPEN), 3))}
    if suffix == ".npz":
        np.savez(path, **given)
    elif suffix == ".npy":
        write_npy(path, given)
    else:
        path.write_bytes(pickle.dumps(given))
    take = read_moving_face(path, None, tmp_path / "flame.npz")
    assert arkit_coefficients(take, calibrate(take))[:, JAW_OPEN] == pytest.approx(np.array(AMOUNTS), abs=0.03)
    # Where the head was not upright, it is turned by its mean.
    middle = np.mean(AMOUNTS) / 2.0 if names == "in a camera" else 0.0
    np.testing.assert_allclose(take.pose[:, 2], middle - np.array(AMOUNTS) / 2.0, atol=0.01)
    np.testing.assert_allclose(take.pose[:, [1, 3]], 0.0, atol=0.01)
    notes = " ".join(map(str, take.info["notes"]))
    assert "Not used: 'cam" in notes
    assert ("180 degrees from upright" in notes) == (names == "in a camera")
    assert ("relative to the hips" in notes) == (names in ("BEAT2", "SMPL-X"))


@pytest.mark.thorough
def test_the_rate_that_a_file_states_is_used_unless_another_is_given(tmp_path):
    write_dense(tmp_path / "flame.npz")
    np.savez(tmp_path / "clip.npz", expressions=OPEN, mocap_frame_rate=120.0)
    stated = read_moving_face(tmp_path / "clip.npz", None, tmp_path / "flame.npz")
    given = read_moving_face(tmp_path / "clip.npz", 60.0, tmp_path / "flame.npz")
    assert stated.times[1] == pytest.approx(1.0 / 120.0) and given.times[1] == pytest.approx(1.0 / 60.0)


@pytest.mark.parametrize("name", ["", pytest.param("verts", marks=pytest.mark.thorough)])
def test_vertices_of_a_model_over_time_become_a_take(tmp_path, name):
    model = flame()
    np.savez(tmp_path / "flame.npz", v_template=model["v_template"], faces=model["f"])
    vertices = np.array([moved(amount) * FILE_AXES for amount in AMOUNTS])
    path = tmp_path / ("clip.npz" if name else "clip.npy")
    if name:
        np.savez(path, **{name: vertices})
    else:
        np.save(path, vertices.reshape(len(vertices), -1))  # as programs that animate faces by speech do
    check(read_moving_face(path, 30.0, tmp_path / "flame.npz"))


def huge(path):
    """Write the header of an array that no memory can hold."""
    with path.open("wb") as stream:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**9, 10**6)}
        np.lib.format.write_array_header_1_0(stream, header)


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: write_npy(path, {"exp": Hostile()}), "contains 'builtins.exec'"),
        (huge, "cannot be read as parameters of a face"),
        (lambda path: path.write_bytes(b"\x93NUMPY\x01\x00damaged"), "cannot be read as parameters of a face"),
        (lambda path: np.save(path, np.full((2, 3 * len(REST)), np.nan)), "has no frame with a face"),
        (lambda path: np.save(path, np.zeros((2, 5))), r"an offset has the shape \(2, 5\)"),
    ],
)
def test_a_hostile_damaged_or_empty_npy_file_is_a_clear_error(tmp_path, write, words):
    write_dense(tmp_path / "flame.npz")
    write(tmp_path / "clip.npy")
    with pytest.raises(SourceError, match=words):
        read_moving_face(tmp_path / "clip.npy", 30.0, tmp_path / "flame.npz")


def test_parameters_of_a_body_with_too_few_joints_are_an_error(tmp_path):
    write_dense(tmp_path / "flame.npz")
    np.savez(tmp_path / "clip.npz", expression=OPEN, body_pose=np.zeros((len(OPEN), 9)))
    with pytest.raises(SourceError, match="the body has 3 joints"):
        read_moving_face(tmp_path / "clip.npz", 30.0, tmp_path / "flame.npz")


def test_parameters_of_gnm_become_a_take(tmp_path):
    model = flame()
    count = len(REST)
    np.savez(
        tmp_path / "gnm_head.npz",
        template_vertex_positions=model["v_template"],
        template_joint_positions=np.zeros((4, 3)),
        vertex_identity_basis=np.zeros((2, count, 3)),
        joint_identity_basis=np.zeros((2, 4, 3)),
        expression_basis=np.moveaxis(model["shapedirs"][:, :, 300:], 2, 0),
        skinning_weights=np.eye(4)[[0]].T * np.ones(count),
        joint_parent_indices=np.array([-1, 0, 1, 1]),
        triangles=model["f"],
        joint_names=np.array(["neck", "head", "left_eye", "right_eye"], dtype=object),
    )
    rotations = np.zeros((len(AMOUNTS), 4, 3))
    rotations[:, 0] = turned(AMOUNTS)
    np.savez(tmp_path / "clip.npz", expression=np.array(AMOUNTS)[:, None], rotations=rotations)
    check(read_moving_face(tmp_path / "clip.npz", 30.0, tmp_path / "gnm_head.npz"))


@pytest.mark.skipif(not GNM.is_file(), reason="GNM's landmarks are not in the shared data")
def test_expressions_of_gnm_become_a_take_by_its_landmarks_alone(tmp_path):
    with np.load(GNM) as landmarks:
        points, modes = landmarks["mediapipe_index"].tolist(), landmarks["expression_modes"]
    closing = modes[:, points.index(17), 1] - modes[:, points.index(0), 1]
    mode = int(np.abs(closing).argmax())
    expression = np.zeros((3, len(modes)))
    expression[:, mode] = -np.sign(closing[mode]) * np.array([0.0, 1.0, 2.0])
    np.savez(tmp_path / "clip.npz", expression=expression)
    take = read_moving_face(tmp_path / "clip.npz", 30.0, GNM)
    assert take.found.all() and "rims of the lips" in take.info["notes"][0]
    lips = arkit_coefficients(take, calibrate(take))
    lower = lips[:, COEFFICIENTS.index("mouthLowerDownLeft")] + lips[:, JAW_OPEN]
    assert (np.diff(lower) > 0.1).all()


@pytest.mark.parametrize(
    "content",
    [pickle.dumps({"v_template": Hostile()}), b"cos\nsystem\n(S'exit 9'\ntR.", b"\x80\x02garbage", pickle.dumps([1])],
)
def test_a_hostile_or_damaged_model_is_refused_without_executing_it(tmp_path, content):
    (tmp_path / "model.pkl").write_bytes(content)
    np.savez(tmp_path / "clip.npz", expr=np.zeros((2, 1)))
    with pytest.raises(SourceError, match=r"model\.pkl (cannot be read as a face model|is not a face model)"):
        read_moving_face(tmp_path / "clip.npz", 30.0, tmp_path / "model.pkl")


def test_parameters_that_do_not_fit_the_model_are_an_error_that_names_both(tmp_path):
    write_dense(tmp_path / "model.npz")
    np.savez(tmp_path / "clip.npz", expr=np.zeros((2, 50)))
    with pytest.raises(SourceError, match=r"clip\.npz does not fit the model model\.npz: 'expr' has the shape"):
        read_moving_face(tmp_path / "clip.npz", 30.0, tmp_path / "model.npz")
    with pytest.raises(SourceError, match="Choose the model's file, too"):
        read_moving_face(tmp_path / "clip.npz", 30.0)
