"""Recordings of other programs come in as takes: Audio2Face, Face Cap, OpenFace and Unity."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from facemime.core.errors import SourceError
from facemime.core.face.landmarks import MOUTH_INNER_LOWER, from_ibug
from facemime.core.face.names import COEFFICIENT_INDEX, COEFFICIENTS
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import LOOKS, gaze_of
from facemime.core.takes.face_space import load_face_space
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.openface import write_openface_csv
from facemime.core.takes.recordings import read_recording
from tests.helpers.recordings import audio2face, face_cap, openface, unity
from tests.helpers.takes import make_take

OPEN = np.array([0.0, 0.25, 1.0, 0.5])
"""How far the jaw is open in each frame of a recording."""


def column(take, name):
    return take.coefficients[:, COEFFICIENT_INDEX[name]]


@pytest.fixture
def file(tmp_path):
    """A function that writes a text to a file of that name, and returns its path."""

    def write(name, text):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


def test_audio2face_s_json_is_read_at_its_rate(file):
    rows = [[float(amount) if name == "jawOpen" else 0.0 for name in COEFFICIENTS] for amount in OPEN]
    take = read_recording(file("a.json", audio2face(list(COEFFICIENTS), rows, exportFps=25.0)))
    np.testing.assert_allclose(take.times, np.arange(4) / 25.0)
    np.testing.assert_allclose(column(take, "jawOpen"), OPEN, atol=1e-6)
    assert len(read_recording(file("b.json", audio2face(list(COEFFICIENTS), rows)))) == 4


def test_audio2face_s_own_names_are_read_as_the_coefficients_they_show(file):
    names = [
        "browLowerL",
        "browLowerR",
        "innerBrowRaiserL",
        "cheekRaiserL",
        "jawDrop",
        "lipCornerPullerL",
        "eyesClosedL",
    ]
    rows = [[0.0, 0.0, 0.0, 0.0, float(amount), 0.5, 0.0] for amount in OPEN]
    take = read_recording(file("a.json", audio2face(names, rows)))
    np.testing.assert_allclose(column(take, "jawOpen"), OPEN, atol=1e-6)
    np.testing.assert_allclose(column(take, "mouthSmileLeft"), 0.5, atol=1e-6)
    assert any("movements" in note for note in take.info["notes"])


def test_face_cap_s_text_is_read_with_its_own_times_and_the_turn_of_the_head(file):
    frames = [(i * 16 + i % 2, (0, 0, 0), {"jawOpen": amount, "eyeBlink_L": 1}) for i, amount in enumerate(OPEN)]
    frames.append((90, (0, 20, 0), {}))
    take = read_recording(file("anna.txt", face_cap(frames)))
    np.testing.assert_allclose(take.times, [0.0, 0.017, 0.032, 0.049, 0.09])
    np.testing.assert_allclose(column(take, "jawOpen")[:4], OPEN, atol=1e-6)
    np.testing.assert_allclose(column(take, "eyeBlinkLeft")[:4], 1.0)
    assert (
        abs(np.degrees(take.result(len(take) - 1).pose[2]) + 20.0) < 1e-3
    )  # about the axis upwards, to the viewer's right


def test_openface_s_action_units_are_read_for_both_sides(file):
    rows = [{"AU26_r": 5.0 * amount, "AU12_r": 2.5, "success": float(i != 2)} for i, amount in enumerate(OPEN)]
    take = read_recording(file("face.csv", openface(rows)))
    assert list(take.found) == [True, True, False, True]
    np.testing.assert_allclose(take.times, np.arange(4) * 0.04)
    np.testing.assert_allclose(column(take, "jawOpen")[take.found], OPEN[take.found], atol=1e-6)
    for side in ("Left", "Right"):
        np.testing.assert_allclose(column(take, f"mouthSmile{side}")[take.found], 0.5, atol=1e-6)


def test_a_head_that_turns_while_its_eyes_stay_on_the_camera_looks_the_other_way(file):
    turned = np.radians(20.0)
    rows = [{}, {"pose_Ry": turned}, {"pose_Rx": turned}, {"gaze_angle_x": 0.2}, {"gaze_angle_y": 0.2}]
    take = read_recording(file("face.csv", openface(rows)))
    poses = [euler_to_matrix(*pose[1:4]) for pose in (take.result(i).pose for i in range(len(take)))]
    assert (poses[1] @ (0.0, 0.0, -1.0))[0] < -0.3 and (poses[2] @ (0.0, 0.0, -1.0))[1] > 0.3
    # Own left is the viewer's right, where a head that turned to the viewer's left has its eyes.
    assert column(take, "eyeLookOutLeft")[1] > 0.3 and column(take, "eyeLookInRight")[1] > 0.3
    assert column(take, "eyeLookUpLeft")[2] > 0.3
    assert column(take, "eyeLookOutLeft")[3] > 0.1 and column(take, "eyeLookDownRight")[4] > 0.1
    assert np.abs([column(take, f"eyeLook{way}Left")[0] for way in ("In", "Out", "Up", "Down")]).max() < 1e-6


def performed(frames):
    """A take of a made-up face whose head turns and whose eyes look around, its neutral face, and coefficients."""
    rng = np.random.default_rng(3)
    pose = np.column_stack([np.full(frames, 120.0), rng.uniform(-0.4, 0.4, (frames, 3)), np.full((frames, 2), 240.0)])
    gaze = rng.uniform(-0.15, 0.15, (frames, 2))
    take = make_take(np.tile(load_face_space().mean, (frames, 1, 1)), pose=pose, gaze=gaze)
    return take, calibrate(take, 0.0), rng.uniform(0.0, 1.0, (frames, len(COEFFICIENTS)))


def test_a_take_written_with_openface_s_columns_is_read_back(tmp_path):
    take, neutral, coefficients = performed(30)
    write_openface_csv(tmp_path / "units.csv", take, neutral, coefficients)
    read = read_recording(tmp_path / "units.csv")
    np.testing.assert_allclose(read.times, take.times, atol=1e-5)
    for frame in range(len(take)):
        turn = euler_to_matrix(*take.pose[0, 1:4]).T @ euler_to_matrix(*take.pose[frame, 1:4])
        first = euler_to_matrix(*read.pose[0, 1:4]).T @ euler_to_matrix(*read.pose[frame, 1:4])
        np.testing.assert_allclose(first, turn, atol=1e-4)
    smiles = [COEFFICIENT_INDEX[f"mouthSmile{side}"] for side in ("Left", "Right")]
    for side in smiles:  # action units do not tell left from right
        np.testing.assert_allclose(read.coefficients[:, side], coefficients[:, smiles].mean(axis=1), atol=1e-5)
    seen = np.array([gaze_of(row[LOOKS])[0] for row in read.coefficients])
    np.testing.assert_allclose(seen, take.gaze, atol=0.01)


def test_a_table_with_openface_s_columns_states_landmarks_gaze_presence_and_doubt(tmp_path):
    take, neutral, coefficients = performed(12)
    take.found[3] = False
    take.shape[5, MOUTH_INNER_LOWER, 1] += 0.35
    take.pose[0, 1:4] = take.gaze[0] = 0.0
    write_openface_csv(tmp_path / "units.csv", take, neutral, coefficients[take.found])
    rows = list(csv.DictReader((tmp_path / "units.csv").open(encoding="utf-8")))
    table = {title: np.array([float(row[title]) for row in rows]) for title in rows[0]}
    assert table["success"].tolist() == [1.0] * 3 + [0.0] + [1.0] * 8
    np.testing.assert_allclose(table["x_36"][0], take.landmarks[0, from_ibug([36])[0], 0], rtol=1e-5)
    assert table["AU25_r"][5] == pytest.approx(5.0) and table["AU25_c"][5] == 1.0 and table["AU25_r"][4] == 0.0
    np.testing.assert_allclose([table[f"gaze_0_{axis}"][0] for axis in "xyz"], (0.0, 0.0, -1.0), atol=1e-6)
    assert table["AU12_doubt"][3] == 1.0
    assert all(table[title].min() >= 0.0 and table[title].max() <= 5.0 for title in table if title.startswith("AU"))


def test_only_the_first_of_openface_s_faces_is_read(file):
    rows = [{"face_id": i % 2, "timestamp": i // 2 * 0.04, "AU26_r": 5.0 * (i % 2)} for i in range(8)]
    take = read_recording(file("faces.csv", openface(rows)))
    assert len(take) == 4 and not column(take, "jawOpen").any()


def test_unity_s_clip_is_sampled_as_unity_plays_it(file):
    straight, jump = (0, 0, 0, 100), (1, 100, 100, 0)
    curves = [
        ("Body", "blendShape.jawOpen", [straight, jump]),
        ("Body", "blendShape.eyeBlinkLeft", [(0, 0, 0, "Infinity"), (0.5, 100, "Infinity", "Infinity"), (1, 0, 0, 0)]),
        ("Body", "blendShape.mouthSmileLeft", [(0, 0, 0, 0), (1, 100, 0, 0)]),
        ("Teeth", "blendShape.jawOpen", [(0, 100, 0, 0)]),
        ("Body", "m_IsActive", [(0, 1, 0, 0)]),
    ]
    take = read_recording(file("Talk.anim", unity(curves)))
    time = np.arange(31) / 30.0
    np.testing.assert_allclose(take.times, time, atol=1e-9)
    np.testing.assert_allclose(column(take, "jawOpen"), time, atol=1e-6)
    np.testing.assert_allclose(column(take, "eyeBlinkLeft"), [*[0.0] * 15, *[1.0] * 15, 0.0], atol=1e-6)
    np.testing.assert_allclose(column(take, "mouthSmileLeft"), 3 * time**2 - 2 * time**3, atol=1e-6)


def test_unity_s_clip_of_another_set_is_read_as_the_coefficients_it_shows(file):
    names = ["vrc.v_aa", "vrc.v_oh", "vrc.v_ou", "vrc.blink_left", "vrc.blink_right"]
    curves = [("Body", f"blendShape.{name}", [(0, 0, 0, 100), (1, 100, 100, 0)]) for name in names]
    take = read_recording(file("Talk.anim", unity(curves)))
    for name in ("jawOpen", "eyeBlinkLeft", "eyeBlinkRight"):
        np.testing.assert_allclose(column(take, name)[-1], 1.0, atol=1e-3)


BROKEN = {
    "a.json": ["", "[]", "{}", '{"facsNames": ["jawOpen"], "weightMat": []}', audio2face(["jawOpen"], [[1.0], []])],
    "b.json": [audio2face(["Fat", "Thin", "Old"], [[1.0, 0.0, 0.0]]), '{"facsNames": 3, "weightMat": 4}'],
    "c.txt": [face_cap([]), face_cap([(0, (0, 0, 0), {})] * 2), face_cap([(0, (0, 0, 0), {})])[:-9] + "x"],
    "d.csv": [openface([]), openface([{}]).replace("0.98", "x"), openface([{}]).replace("timestamp", "Zeit")],
    "e.anim": ["", "%YAML 1.1\nAnimationClip:\n", unity([]), unity([("B", "blendShape.Fat", [(0, 1, 0, 0)])])],
    "f.anim": [unity([("B", "blendShape.jawOpen", [(0, 1, 0, 0), (9e9, 1, 0, 0)])])],
}


@pytest.mark.parametrize(("name", "text"), [(name, text) for name, texts in BROKEN.items() for text in texts])
def test_a_damaged_recording_is_refused_with_its_reason(name, text, file):
    with pytest.raises(SourceError, match=name):
        read_recording(file(name, text))


def test_a_missing_recording_is_named(tmp_path):
    with pytest.raises(SourceError, match="no file"):
        read_recording(tmp_path / "none.json")
