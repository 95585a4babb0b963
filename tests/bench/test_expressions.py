"""The benchmark of expressions: the signs of its features, and its scores."""

from pathlib import Path

import numpy as np
import pytest

from facemime.core.base.landmarks import BROWS, LOWER_LIDS, MOUTH_CORNERS, UPPER_LIDS, from_ibug, outer_eye_distance
from facemime.core.heads.rig import built_in_head
from lab.bench.expressions import THRESHOLDS, Clip, Score, features, read_clips, score, slope

RIG = built_in_head()
REST = np.asarray(RIG.vertices, dtype=np.float64)[RIG.landmarks]
UNIT = outer_eye_distance(REST)


def moved(landmarks: np.ndarray, right: float = 0.0, down: float = 0.0) -> np.ndarray:
    """(1, 66, 3) the head at rest with some landmarks moved, eye distances."""
    points = REST.copy()
    points[landmarks, :2] += np.array([right, down]) * UNIT
    return points[None]


@pytest.mark.parametrize(
    ("points", "name", "sign"),
    [
        (moved(BROWS[:5], down=-0.1), "brow_l", 1),
        (moved(BROWS[5:], down=0.05), "brow_r", -1),
        (moved(from_ibug((20, 21, 22, 23)), down=-0.1), "brow_in", 1),
        (moved(from_ibug(range(65, 68)), down=0.2), "jaw", 1),
        (moved(MOUTH_CORNERS, down=-0.1), "smile", 1),
        (moved(MOUTH_CORNERS[:1], right=0.1), "width", -1),
        (moved(MOUTH_CORNERS, right=0.1), "side", 1),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_features_have_the_signs_of_their_labels_and_are_zero_at_rest(points, name, sign):
    assert np.sign(features(points, REST)[name][0]) == sign
    assert abs(features(points, REST)[name][0]) > THRESHOLDS[name]
    assert all(abs(value[0]) < 1e-12 for value in features(REST[None], REST).values())


def test_a_shut_eye_has_the_value_one_whatever_its_opening_at_rest():
    shut = REST.copy()
    shut[UPPER_LIDS[:2]] = shut[LOWER_LIDS[:2]]
    found = features(shut[None], REST)
    assert found["lid_l"][0] == pytest.approx(1.0) and found["lid_r"][0] == pytest.approx(0.0, abs=1e-9)


def test_scores_count_pairs_in_order_and_frames_on_their_side_of_rest():
    labels = {frame: dict.fromkeys(THRESHOLDS, ".") | {"brow_l": label} for frame, label in enumerate("0121")}
    shown = {name: np.zeros(4) for name in THRESHOLDS} | {"brow_l": np.array([0.0, 0.1, 0.05, np.nan])}
    scores: dict[str, Score] = {}
    wrong = score(Clip(Path("a.mp4"), labels, None, None), shown, scores)
    assert scores["brow_l"].sign == [True, True, True, False] and len(wrong) == 1 and "frame 3" in wrong[0]
    assert sorted(scores["brow_l"].order) == [False, False, False, True, True]
    assert scores["jaw"].sign == []


def test_missing_clips_are_left_out(tmp_path, capsys):
    (tmp_path / "labels.csv").write_text(f"clip,frame,{','.join(THRESHOLDS)}\na,3,1,0,0,0,0,0,0,0,0\nb,1{',.' * 9}\n")
    (tmp_path / "neutral.csv").write_text("clip,first,last,best_frontal,remark\na,2,4,.,fine\n")
    (tmp_path / "a.mp4").touch()
    (clip,) = read_clips(tmp_path / "labels.csv", tmp_path / "neutral.csv", tmp_path)
    assert clip.neutral == (2, 4) and clip.frontal is None and clip.labels[3]["brow_l"] == "1"
    assert "b is left out" in capsys.readouterr().err


def test_a_mouth_that_opens_half_as_far_has_half_the_slope_whatever_its_rest() -> None:
    performer = np.array([0.0, 0.1, 0.4, np.nan, 0.2])
    avatar = np.array([0.05, 0.1, 0.25, 0.3, 0.15])
    assert abs(slope(avatar, performer) - 0.5) < 1e-12
