"""The built-in heads: their meshes, landmarks, regions and face units."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.errors import ModelError
from facemime.core.face.landmarks import LIPS, MIRROR, from_ibug
from facemime.core.face.rotation import fit_rotation
from facemime.core.heads.built_in import (
    HEAD_FILE,
    LOOKS,
    PART_NAMES,
    WOMAN_FILE,
    Head,
    load_head,
    looks_of,
)

SIDED = ["browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp"]
SIDED += ["eyeSquint", "eyeWide", "mouthDimple", "mouthFrown", "mouthLowerDown", "mouthPress", "mouthSmile"]
SIDED += ["mouthStretch", "mouthUpperUp", "noseSneer"]
SINGLE = ["browInnerUp", "cheekPuff", "jawForward", "jawLeft", "jawOpen", "jawRight", "mouthClose", "mouthFunnel"]
SINGLE += ["mouthLeft", "mouthPucker", "mouthRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower"]
SINGLE += ["mouthShrugUpper", "tongueOut"]

INTEROCULAR = 0.085
UPPER, MIDDLE, LOWER = 0, 1, 2


@pytest.fixture(scope="module", params=[HEAD_FILE, WOMAN_FILE], ids=["man", "woman"])
def head(request) -> Head:
    return load_head(request.param)


def corners(faces: np.ndarray) -> list[list[int]]:
    return [[int(v) for v in face if v >= 0] for face in faces]


def directed_edges(faces: np.ndarray) -> list[tuple[int, int]]:
    return [(a, b) for face in corners(faces) for a, b in zip(face, face[1:] + face[:1], strict=True)]


def posed(head: Head, **weights: float) -> np.ndarray:
    """Landmarks of the head under face units."""
    moved = head.vertices + sum(w * head.units[head.unit_names.index(name)] for name, w in weights.items())
    return moved[head.landmarks]


def gap(points: np.ndarray, upper: list[int], lower: list[int]) -> float:
    return float((points[from_ibug(lower), 1] - points[from_ibug(upper), 1]).mean())


def test_the_skin_has_1781_vertices_and_each_belongs_to_a_face(head):
    assert head.vertices.shape == (1781, 3)
    assert np.array_equal(np.unique(head.faces[head.faces >= 0]), np.arange(1781))


def test_the_skin_is_its_own_mirror_image(head):
    flipped = head.vertices * np.float32([-1, 1, 1])
    distance = np.linalg.norm(flipped[:, None] - head.vertices[None], axis=2)
    assert distance.min(axis=1).max() < 1e-6
    other = distance.argmin(axis=1)
    faces = {frozenset(face) for face in corners(head.faces)}
    assert faces == {frozenset(int(other[v]) for v in face) for face in corners(head.faces)}


def test_every_edge_has_at_most_one_face_on_each_side(head):
    for faces in (head.faces, *(part.faces for part in head.parts)):
        edges = directed_edges(faces)
        assert len(edges) == len(set(edges))


def test_no_face_is_degenerate(head):
    for face in corners(head.faces):
        p = head.vertices[face].astype(np.float64)
        normal = sum(np.cross(p[i] - p[0], p[i + 1] - p[0]) for i in range(1, len(p) - 1))
        assert np.linalg.norm(normal) > 1e-10


def test_the_skin_is_open_only_at_the_eyes_and_the_neck(head):
    edges = set(directed_edges(head.faces))
    after = {a: b for a, b in edges if (b, a) not in edges}
    loops = []
    while after:
        start, loop = next(iter(after)), []
        while start in after:
            loop.append(start)
            start = after.pop(start)
        loops.append(loop)
    middles = sorted(float(head.vertices[loop, 0].mean()) for loop in loops)
    assert len(loops) == 3
    assert middles[0] < -0.02 and abs(middles[1]) < 1e-6 and middles[2] > 0.02


def test_faces_of_the_skin_look_outwards(head):
    centres = np.array([head.vertices[face].mean(axis=0) for face in corners(head.faces)])
    normals = np.array([np.cross(*(head.vertices[face[1:3]] - head.vertices[face[0]])) for face in corners(head.faces)])
    forehead = (centres[:, 1] < -0.03) & (np.abs(centres[:, 0]) < 0.05)
    assert ((normals * centres).sum(axis=1)[forehead] > 0).mean() > 0.99


@pytest.mark.parametrize("file", [None, WOMAN_FILE])
def test_every_face_of_an_eye_looks_outwards(file):
    for part in load_head(file).parts[:2]:
        corners = part.vertices[part.faces[:, :3]].astype(float)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outwards = corners.mean(axis=1) - part.vertices.mean(axis=0)
        assert part.name.startswith("eye") and (np.einsum("fc,fc->f", normals, outwards) > 0.0).all()


def test_landmarks_are_distinct_vertices_and_mirror_each_other(head):
    points = head.vertices[head.landmarks]
    assert len(set(head.landmarks.tolist())) == 66
    assert np.abs(points[MIRROR] * [-1, 1, 1] - points).max() < 1e-6


def test_the_head_stands_in_the_head_frame(head):
    points = head.vertices[head.landmarks]
    chin, nose, brow = points[from_ibug([8, 30, 19])]
    outer_right, outer_left = points[from_ibug([36, 45])]
    assert brow[1] < nose[1] < chin[1], "y runs downwards"
    assert nose[2] < points[0][2], "the face looks along -z"
    assert outer_right[0] < 0 < outer_left[0], "the performer's left is on the viewer's right"
    assert 0.07 < outer_left[0] - outer_right[0] < 0.10, "metres"
    assert head.vertices[:, 2].min() < 0 < head.vertices[:, 2].max()


def test_region_weights_are_shares(head):
    assert head.regions.shape == (3, 1781)
    assert head.regions.min() >= 0 and head.regions.sum(axis=0).max() <= 1 + 1e-6


def test_regions_separate_lid_from_lid_and_lip_from_lip(head):
    def share(numbers: list[int]) -> np.ndarray:
        return head.regions[:, head.landmarks[from_ibug(numbers)]]

    assert np.allclose(share([37, 38, 43, 44])[UPPER], 1)
    assert np.allclose(share([40, 41, 46, 47])[MIDDLE], 1)
    assert np.allclose(share([49, 50, 51, 52, 53, 61, 62, 63])[MIDDLE], 1)
    assert np.allclose(share([55, 56, 57, 58, 59, 65, 66, 67])[LOWER], 1)
    assert np.allclose(share([36, 39, 42, 45])[[UPPER, MIDDLE]], 0.5, atol=0.05)
    assert np.allclose(share([48, 54])[[MIDDLE, LOWER]], 0.5, atol=0.05)


def test_no_edge_joins_a_lip_fully_in_one_region_to_the_other_lip(head):
    corner = head.vertices[head.landmarks[from_ibug([54])[0]]]
    middle, lower = head.regions[MIDDLE] == 1, head.regions[LOWER] == 1
    near = (np.abs(head.vertices[:, 0]) < 0.7 * corner[0]) & (head.vertices[:, 2] < corner[2])
    assert not [(a, b) for a, b in directed_edges(head.faces) if middle[a] and lower[b] and near[a] and near[b]]


def test_skull_ears_and_the_cut_of_the_neck_are_in_no_region(head):
    weight = head.regions.sum(axis=0)
    x, y, z = head.vertices.T
    mouth = (np.abs(x) < 0.04) & (y > 0.03) & (y < 0.1)
    assert weight[(z > 0.01) & ~mouth].max() == 0
    assert weight[(z > 0.0) & ~mouth].max() < 0.2
    assert weight[np.abs(x) > 0.082].max() == 0
    edges = set(directed_edges(head.faces))
    rim = [a for a, b in edges if (b, a) not in edges and head.vertices[a, 1] > 0.05]
    assert rim and weight[rim].max() == 0


def test_the_units_are_the_52_of_arkit(head):
    expected = SINGLE + [f"{name}{side}" for name in SIDED for side in ("Left", "Right")]
    assert sorted(expected) == list(head.unit_names)
    assert head.units.shape == (52, 1781, 3)


def test_a_blink_closes_the_lids_of_its_own_eye_only(head):
    rest = gap(head.vertices[head.landmarks], [43, 44], [47, 46])
    points = posed(head, eyeBlinkLeft=1.0)
    assert abs(gap(points, [43, 44], [47, 46])) < 0.1 * rest
    assert gap(points, [37, 38], [41, 40]) == pytest.approx(rest, rel=0.02)


def test_a_tongue_that_is_out_lies_in_front_of_the_lips_and_above_the_lower_lip(head):
    tongue, unit = head.part("tongue"), head.unit_names.index("tongueOut")
    lips = head.vertices[head.landmarks[LIPS]]
    out = tongue.vertices + tongue.units[unit]
    tip = out[np.argmin(out[:, 2])]
    assert tongue.vertices[:, 2].min() > lips[:, 2].max() - 0.01
    assert tip[2] < lips[:, 2].min() - 0.01
    assert lips[:, 1].min() < tip[1] < lips[:, 1].max()


def test_an_open_jaw_opens_the_mouth_and_lowers_chin_teeth_and_tongue(head):
    rest, points = head.vertices[head.landmarks], posed(head, jawOpen=1.0)
    mouth = ([61, 62, 63], [67, 66, 65])
    assert gap(points, *mouth) > gap(rest, *mouth) + 0.25 * INTEROCULAR
    assert (points - rest)[from_ibug([8])[0], 1] > 0.01
    row = head.unit_names.index("jawOpen")
    lowered = {part.name: float(part.units[row, :, 1].max()) for part in head.parts}
    assert lowered["teeth_lower"] > 0.01 and lowered["tongue"] > 0.005
    assert lowered["teeth_upper"] == lowered["eye_left"] == 0


def test_an_open_mouth_shows_the_upper_teeth_and_the_tongue_lies_below_the_edge_of_the_lower(head):
    inner = from_ibug([62])
    edge = head.part("teeth_upper").vertices[:, 1].max()
    assert head.vertices[head.landmarks[inner], 1].max() > edge - 0.001
    assert posed(head, jawOpen=1.0)[inner, 1].max() < edge - 0.001
    tongue, teeth = head.part("tongue").vertices, head.part("teeth_lower").vertices
    front = teeth[:, 2] < teeth[:, 2].min() + 0.004
    assert tongue[:, 1].min() > teeth[front, 1].min() and tongue[:, 2].min() > teeth[:, 2].min() + 0.004


def test_a_funnel_draws_the_corners_in_and_parts_the_lips_and_a_pucker_keeps_them_shut(head):
    rest = head.vertices[head.landmarks]
    right, left = from_ibug([48, 54])
    mouth = ([61, 62, 63], [67, 66, 65])
    width = rest[left, 0] - rest[right, 0]
    for name, parted in (("mouthFunnel", True), ("mouthPucker", False)):
        points = posed(head, **{name: 1.0})
        assert points[left, 0] - points[right, 0] < 0.85 * width
        assert points[from_ibug([51, 57]), 2].max() < rest[from_ibug([51, 57]), 2].max() - 0.003
        assert (gap(points, *mouth) > 0.06 * INTEROCULAR) == parted


def test_a_smile_widens_the_mouth_and_lifts_its_corners(head):
    rest, points = head.vertices[head.landmarks], posed(head, mouthSmileLeft=1.0, mouthSmileRight=1.0)
    right, left = from_ibug([48, 54])
    assert points[left, 0] - points[right, 0] > 1.1 * (rest[left, 0] - rest[right, 0])
    assert points[left, 1] < rest[left, 1] and points[right, 1] < rest[right, 1]


def test_parts_lie_where_they_belong(head):
    assert tuple(part.name for part in head.parts) == PART_NAMES
    eye_left, eye_right, upper, lower = head.parts[:4]
    assert eye_left.pivot[0] > 0 > eye_right.pivot[0]
    assert np.ptp(np.linalg.norm(eye_left.vertices - eye_left.pivot, axis=1)) < 0.001
    assert upper.vertices[:, 1].mean() < lower.vertices[:, 1].mean()
    assert np.allclose(lower.pivot, head.jaw_pivot)


def test_eyes_turn_sideways_as_far_as_a_phone_means_and_less_up_and_down(head):
    for place, column in enumerate(LOOKS.tolist()):
        turns = []
        for side in ("right", "left"):
            eye = head.part(f"eye_{side}")
            rest = (eye.vertices - eye.pivot).astype(np.float64)
            turns.append(fit_rotation(rest, rest + eye.units[column]))
        share = 24.0 / 35.2 if head.unit_names[column].startswith(("eyeLookUp", "eyeLookDown")) else 1.0
        np.testing.assert_allclose(looks_of(np.array(turns)[None])[0], share * np.eye(len(LOOKS))[place], atol=2e-3)


def test_lashes_are_rooted_at_the_lids_and_brows_in_the_skin(head):
    lashes = head.part("lashes").vertices
    eyes = head.vertices[head.landmarks[from_ibug(range(36, 48))]]
    brows = head.vertices[head.landmarks[from_ibug(range(17, 27))]]
    for points in (eyes, brows):
        near = np.linalg.norm(lashes[:, None] - points, axis=2).min(axis=1)
        assert (near < 0.012).sum() > 400
    assert np.linalg.norm(lashes[:, None] - np.concatenate([eyes, brows]), axis=2).min(axis=1).max() < 0.02


def test_a_blink_carries_the_lashes_down_and_raised_brows_carry_their_hairs_up(head):
    lashes = head.part("lashes")
    for unit, low, high in (("eyeBlinkLeft", 0.003, 0.015), ("browOuterUpLeft", -0.015, -0.003)):
        moved = lashes.units[head.unit_names.index(unit)]
        extreme = moved[:, 1].max() if low > 0 else moved[:, 1].min()
        assert low < extreme < high
        assert np.abs(moved[lashes.vertices[:, 0] < -0.005]).max() < 0.001, "the other side stays"


def test_hair_covers_the_skull_and_leaves_the_face_free(head):
    hair = head.part("hair").vertices
    assert hair[:, 1].min() < head.vertices[:, 1].min()
    face = head.vertices[head.landmarks]
    inside = (np.abs(hair[:, 0]) < 0.03) & (hair[:, 1] > face[:, 1].min()) & (hair[:, 2] < face[:, 2].max())
    assert not inside.any()


def test_texture_coordinates_lie_within_the_image(head):
    for mesh in (head, *head.parts):
        assert mesh.uv.shape == (*mesh.faces.shape, 2)
        assert mesh.uv.min() >= 0 and mesh.uv.max() <= 1


def test_vertices_of_the_same_number_are_at_the_same_place_on_both_heads():
    man, woman = load_head(HEAD_FILE), load_head(WOMAN_FILE)
    assert np.array_equal(man.faces, woman.faces) and np.array_equal(man.landmarks, woman.landmarks)
    assert 0.001 < np.linalg.norm(man.vertices - woman.vertices, axis=1).mean() < 0.02


def test_a_missing_head_is_refused_by_name(tmp_path):
    with pytest.raises(ModelError, match=r"nowhere\.npz is missing"):
        load_head(tmp_path / "nowhere.npz")


def test_a_foreign_file_is_refused(tmp_path):
    np.savez(tmp_path / "foreign.npz", vertices=np.zeros((4, 3)))
    with pytest.raises(ModelError, match="not a Facemime head"):
        load_head(tmp_path / "foreign.npz")


def test_a_head_whose_arrays_do_not_fit_is_refused(tmp_path):
    with np.load(HEAD_FILE) as file:
        arrays = {key: file[key] for key in file.files}
    np.savez(tmp_path / "short.npz", **(arrays | {"regions": arrays["regions"][:, :-1]}))
    with pytest.raises(ModelError, match="regions has the shape"):
        load_head(tmp_path / "short.npz")
    del arrays["units"]
    np.savez(tmp_path / "lacking.npz", **arrays)
    with pytest.raises(ModelError, match="incomplete"):
        load_head(tmp_path / "lacking.npz")


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("vertices", lambda a: a.__setitem__((5, 1), np.nan), "vertices is not finite"),
        ("units", lambda a: a.__setitem__((0, 0, 0), np.inf), "units is not finite"),
        ("landmarks", lambda a: a.__setitem__(3, -1), "landmarks is not within"),
        ("landmarks", lambda a: a.__setitem__(slice(None), 7), "two landmarks coincide"),
        ("regions", lambda a: a.__setitem__((0, 0), 2.0), "regions has weights"),
        ("faces", lambda a: a.__setitem__((0, 1), a[0, 0]), "faces has a degenerate face"),
        ("tongue.faces", lambda a: a.__setitem__((0, 0), -1), "tongue.faces has a degenerate face"),
    ],
)
def test_a_head_with_impossible_values_is_refused(tmp_path, name, change, message):
    with np.load(HEAD_FILE) as file:
        arrays = {key: file[key] for key in file.files}
    change(arrays[name])
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(ModelError, match=message):
        load_head(tmp_path / "bad.npz")


@given(st.floats(0.0, 0.999), st.integers(0, 255))
def test_a_truncated_head_is_refused(tmp_path_factory, share, filler):
    content = HEAD_FILE.read_bytes()
    path: Path = tmp_path_factory.mktemp("heads") / "cut.npz"
    path.write_bytes(content[: int(share * len(content))] + bytes([filler]))
    with pytest.raises(ModelError):
        load_head(path)
