"""Parts of a character: pieces of meshes, their assignment by name and place, bones, and motion with the skin."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.deform.head_deformer import head_deformer
from facemime.core.deform.lid_rims import lid_rims
from facemime.core.drive.driver import HeadDriver
from facemime.core.drive.glue import Glue, Roots, nearest_triangles
from facemime.core.drive.parts import PartDriver
from facemime.core.face.landmarks import (
    BROWS,
    EYE_LEFT,
    EYE_RIGHT,
    JAW,
    LIPS,
    LOWER_LIDS,
    UPPER_LIDS,
    outer_eye_distance,
)
from facemime.core.face.rotation import euler_to_matrix
from facemime.core.heads.built_in import load_head
from facemime.core.heads.eyeballs import part_eyeball, sphere_of_lids
from facemime.core.heads.part_names import FaceBones, find_bones, named_part, names_body, names_skin
from facemime.core.heads.rig import FaceParts, Part, built_in_head
from facemime.core.heads.sorting import Piece, lower_row, sort_pieces
from facemime.core.mesh.surface import triangulate
from facemime.core.takes.neutral import calibrate
from tests.helpers.parted_heads import KINDS, with_parts
from tests.helpers.takes import performance

ANGLES = st.floats(-1.2, 1.2)


def test_a_tongue_without_a_name_between_the_teeth_moves_with_the_lower_ones():
    head, points = load_head(), built_in_head().vertices[built_in_head().landmarks]
    found = {part.name: part.vertices for part in head.parts if part.name in ("teeth_upper", "teeth_lower", "tongue")}
    unit = outer_eye_distance(points)
    for raised in np.linspace(0.0, 0.06, 7) * unit:  # as high as the upper teeth are far
        pieces = [Piece(found[name] - (0.0, raised * (name == "tongue"), 0.0), ("mouth",)) for name in sorted(found)]
        assert sort_pieces(pieces, points) == [Part.TEETH_LOWER, Part.TEETH_UPPER, Part.TEETH_LOWER]


def test_a_tongue_alone_in_a_mouth_moves_with_the_jaw_as_a_whole():
    head, points = load_head(), built_in_head().vertices[built_in_head().landmarks]
    tongue = next(part.vertices for part in head.parts if part.name == "tongue")
    for raised in np.linspace(0.0, 0.06, 4) * outer_eye_distance(points):
        assert sort_pieces([Piece(tongue - (0.0, raised, 0.0), ("mouth",))], points) == [Part.TEETH_LOWER]


def test_a_neck_without_a_name_below_the_chin_is_not_teeth():
    points = built_in_head().vertices[built_in_head().landmarks].astype(np.float64)
    unit, chin = outer_eye_distance(points), points[JAW[8]]
    angle = np.linspace(0.0, 2.0 * np.pi, 16)
    ring = 0.4 * unit * np.column_stack([np.cos(angle), np.zeros(16), np.sin(angle)])
    rings = [ring + chin + (0.0, low * unit, 0.7 * unit) for low in (-0.25, 0.1)]
    found = sort_pieces([Piece(np.concatenate(rings), ("Material",), away=0.5, moving=False)], points)
    assert found == [Part.ON_HEAD]


def test_both_rows_of_teeth_in_one_piece_are_divided_even_without_anything_else():
    head, points = load_head(), built_in_head().vertices[built_in_head().landmarks]
    found = {part.name: part.vertices for part in head.parts if part.name in ("teeth_upper", "teeth_lower", "tongue")}
    for names in (("teeth_upper", "teeth_lower"), tuple(found)):
        piece = np.concatenate([found[name] for name in names])
        assert sort_pieces([Piece(piece, ("mouth",))], points) == [None]


def test_lashes_and_brows_of_the_hairs_mesh_ride_on_the_skin_and_a_fringe_does_not():
    points = built_in_head().vertices[built_in_head().landmarks].astype(np.float64)
    unit = outer_eye_distance(points)
    up = np.array([0.0, -0.06, -0.02]) * unit
    lines = [points[EYE_RIGHT][:4], points[EYE_LEFT][:4], points[BROWS[:5]], points[BROWS[5:]]]
    pieces = [Piece(np.concatenate([line, line + up]), ("Hair",), away=0.05) for line in lines]
    assert sort_pieces(pieces, points) == [Part.ON_SKIN] * 4
    long = [Piece(np.concatenate([line, line + 5 * up]), ("Hair",), away=0.05) for line in lines]
    narrow = [Piece(np.concatenate([line[:2], line[:2] + up]), ("髪",), away=0.05) for line in lines]
    glasses = [Piece(piece.vertices, ("Glasses",), away=0.05) for piece in pieces]
    assert sort_pieces([*long, *narrow, *glasses], points) == [Part.ON_HEAD] * 12


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("Wolf3D_Teeth", Part.TEETH_UPPER),
        ("Human.eyelashes01", Part.ON_SKIN),
        ("CC_Base_EyeOcclusion", Part.ON_SKIN),
        ("N00_000_00_FaceBrow_00_FACE (Instance)", Part.ON_SKIN),
        ("N00_000_00_EyeIris_00_EYE (Instance)", Part.EYE_LEFT),
        ("teeth_lower_mesh", Part.TEETH_LOWER),
        ("Tongue", Part.TEETH_LOWER),
        ("Wolf3D_Glasses", Part.ON_HEAD),
        ("EyeGlasses", Part.ON_HEAD),
        ("Hair_01", Part.ON_HEAD),
        ("Wolf3D_Head", None),
        ("Wolf3D_Skin", None),
        ("Eyelid", None),
        ("Handle", None),
        ("Material.001", None),
        ("eye_brown", Part.EYE_LEFT),
        ("Mustache", Part.ON_SKIN),
        ("eyelashmesh", Part.ON_SKIN),
        ("EyeSocket", None),
        ("Chair", None),
        ("Splash", None),
        ("Thorns", None),
        ("Irish Setter", None),
        ("まつ毛", Part.ON_SKIN),
        ("眼鏡", Part.ON_HEAD),
        ("白目", Part.EYE_LEFT),
        ("白目の影", Part.ON_SKIN),
        ("eyeshell_lod0_mesh", Part.ON_SKIN),
        ("cartilage_lod0_mesh", Part.ON_SKIN),
        ("afro01", Part.ON_HEAD),
        ("short04", None),
    ],
)
def test_parts_are_recognised_by_name(name, part):
    assert named_part([name]) == part


def test_the_most_telling_name_decides():
    assert named_part(["Std_Eyelash", "CC_Base_Body"]) == Part.ON_SKIN
    assert named_part(["Hair", "Eyebrows"]) == named_part(["Eyebrows", "Hair"]) == Part.ON_SKIN
    assert named_part(["Glass", "Eye_L"]) == Part.EYE_LEFT
    assert named_part(["Hair", "Head_Hair_Eyes_Brows"]) == Part.ON_HEAD, "a name of several parts tells nothing"
    assert named_part(["Material", "LowerJawTeeth"]) == Part.TEETH_LOWER
    assert names_skin("Wolf3D_Head") and not names_skin("HeadBand") and names_body("Wolf3D_Outfit_Top")
    assert not names_skin("F00_001_01_Body_00_SKIN") and not names_skin("Std_Skin_Arm") and names_skin("Std_Skin_Head")
    assert names_body("スカート") and not names_body("short04") and names_body("Std_Skin_Leg")
    assert not names_body("Cube.001") and not names_body("Body_Skin_Head") and not names_body("Eye Socket")
    assert not names_skin("Water Surface") and not names_skin("Forehead Wrap") and names_skin("顔")


@pytest.mark.parametrize(
    ("names", "wanted"),
    [
        (["mixamorig:Neck", "mixamorig:Head", "mixamorig:HeadTop_End", "mixamorig:LeftEye", "mixamorig:RightEye"],) * 2,
        (["Neck", "Head", "HeadTop_End", "LeftEye", "RightEye"],) * 2,
        (["J_Bip_C_Neck", "J_Bip_C_Head", "", "J_Adj_L_FaceEye", "J_Adj_R_FaceEye"],) * 2,
        (["neck.x", "c_head.x", "", "c_eye.l", "c_eye.r"],) * 2,
        (["neck", "head", "", "master_eye.L", "master_eye.R"],) * 2,
        (["neck_01", "head", "", "FACIAL_L_Eye", "FACIAL_R_Eye"],) * 2,
        (["CC_Base_NeckTwist01", "CC_Base_Head", "", "CC_Base_L_Eye", "CC_Base_R_Eye"],) * 2,
        (["Bip01 Neck", "Bip01 Head", "", "lEye", "rEye"],) * 2,
        (["neck03", "head", "", "eye.L", "eye.R"],) * 2,
        (["Bip001 Neck", "Bip001 Head", "Bip001 HeadNub", "Bip001 LEye", "Bip001 REye"],) * 2,
        (["neck", "head", "jaw", "left_eye_smplhf", "right_eye_smplhf"],) * 2,
        (["首", "頭", "両目", "左目", "右目"],) * 2,
        (["首", "頭", "左目先", "目.L", "目.R"],) * 2,
    ],
)
def test_the_bones_of_common_rigs_are_found(names, wanted):
    bones = find_bones([name for name in names if name], {})
    assert (bones.head, bones.eye_left, bones.eye_right) == (wanted[1], wanted[3], wanted[4])


def test_a_rig_without_names_gives_the_bone_that_moves_most_of_the_face():
    assert find_bones(["Bone", "Bone.001"], {"Bone": 3.0, "Bone.001": 40.0}) == FaceBones(head="Bone.001")
    assert find_bones(["LeftHand", "Spine"], {}) == FaceBones()


def test_parts_without_names_are_sorted_by_their_places():
    head = load_head()
    points = head.vertices[head.landmarks].astype(np.float64)
    pieces = [Piece(head.vertices, ("", "Object"), skin=True)]
    inside = [part for part in head.parts if part.name in KINDS]
    pieces += [Piece(part.vertices, ("", f"Object.{i}"), away=0.3) for i, part in enumerate(inside)]
    assert sort_pieces(pieces, points) == [Part.SKIN, *(KINDS[part.name] for part in inside)]


def test_teeth_and_tongue_that_are_named_like_the_wall_of_the_mouth_are_found_by_their_places():
    head = load_head()
    points = head.vertices[head.landmarks].astype(np.float64)
    wall = points[LIPS] + (0.0, 0.0, 0.02)
    names = ("N00_000_00_FaceMouth_00_FACE", "Face")
    pieces = [Piece(head.vertices, ("", "Face"), skin=True), Piece(wall, names, joined=True)]
    inside = [part for part in head.parts if part.name in ("teeth_upper", "teeth_lower", "tongue")]
    pieces += [Piece(part.vertices, names, away=0.3) for part in inside]
    assert sort_pieces(pieces, points) == [Part.SKIN, Part.ON_SKIN, *(KINDS[part.name] for part in inside)]


def test_a_piece_close_to_moving_skin_rides_on_it_and_one_on_the_skull_rides_on_the_head():
    head = load_head()
    points = head.vertices[head.landmarks].astype(np.float64)
    brow = points[17:22] - (0.0, 0.0, 0.002)
    pieces = [Piece(brow, ("", "a"), away=0.03), Piece(brow, ("", "b"), away=0.03, moving=False)]
    assert sort_pieces([*pieces, Piece(brow - 0.1, ("", "c"), away=0.5)], points) == [
        Part.ON_SKIN,
        Part.ON_HEAD,
        Part.ON_HEAD,
    ]


def test_gums_joined_to_a_tongue_are_divided_where_they_grow():
    head = load_head()
    points = head.vertices[head.landmarks].astype(np.float64)
    unit, slit = outer_eye_distance(points), points[LIPS].mean(axis=0)
    tongue = -0.05  # above the slit of the mouth
    profile = [
        (-0.3, 0.1),
        (-0.25, 0.1),
        (-0.2, 0.7),
        (tongue, 0.6),
        (tongue, 0.2),
        (0.1, 0.25),
        (0.25, 0.15),
        (0.3, 0.15),
    ]
    across = np.linspace(-0.25, 0.25, 9)
    places = np.array([(x, slit[1] / unit + y, slit[2] / unit + z) for y, z in profile for x in across]) * unit
    row = np.arange(len(places)).reshape(len(profile), 9)
    faces = np.stack([row[:-1, :-1], row[:-1, 1:], row[1:, 1:], row[1:, :-1]], axis=-1).reshape(-1, 4)
    lower = lower_row(places, faces, points).reshape(row.shape)
    assert not lower[:2].any() and lower[4:].all()
    teeth = [Piece(places[row[rows].ravel()], ("", "tooth")) for rows in ([0, 1], [6, 7])]
    gums = Piece(places, ("", "piece"))
    assert sort_pieces([*teeth, gums], points) == [Part.TEETH_UPPER, Part.TEETH_LOWER, None]


@pytest.mark.parametrize("side", [EYE_RIGHT, EYE_LEFT])
def test_lashes_and_films_of_tears_are_not_eyes_but_ride_on_the_lids(side):
    head = load_head()
    points = head.vertices[head.landmarks].astype(np.float64)
    rim, width = points[side], float(np.ptp(points[side][:, 0]))
    middle = rim.mean(axis=0)
    lashes = np.concatenate([rim, middle + 1.3 * (rim - middle) - (0.0, 0.0, 0.2 * width)])
    tears = np.concatenate([rim, middle + 0.7 * (rim - middle) - (0.0, 0.0, 0.05 * width)])
    iris = middle + 0.15 * width * np.array([(np.cos(a), np.sin(a), 0.0) for a in np.linspace(0.0, 6.0, 12)])
    grid = np.linspace(0.1, np.pi - 0.1, 9)
    ball = np.array([(np.sin(a) * np.cos(2 * b), np.cos(a), np.sin(a) * np.sin(2 * b)) for a in grid for b in grid])
    ball = middle + (0.0, 0.0, 0.35 * width) + 0.45 * width * ball
    front = ball[ball[:, 2] < middle[2] + 0.35 * width]
    pieces = [Piece(places, ("", "Object"), away=0.05) for places in (lashes, tears, iris, ball, front)]
    eye = Part.EYE_RIGHT if side is EYE_RIGHT else Part.EYE_LEFT
    assert sort_pieces(pieces, points) == [Part.ON_SKIN, Part.ON_SKIN, eye, eye, eye]


@given(ANGLES, ANGLES, ANGLES)
def test_parts_on_rigidly_moving_skin_move_with_it(pitch, yaw, roll):
    rng = np.random.default_rng(3)
    skin = rng.uniform(-1.0, 1.0, (60, 3))
    points = rng.uniform(-1.0, 1.0, (12, 3)) * 1.5
    turn = euler_to_matrix(pitch / 3, yaw / 3, roll / 3)
    moved = skin @ turn.T + (0.3, -0.2, 0.1)
    glue = Glue(points, Roots.by_nearest(np.arange(12)), skin, np.zeros(60, dtype=int), 1.0)
    expected = points @ turn.T + (0.3, -0.2, 0.1)
    size = np.linalg.norm(points, axis=1).max()
    assert np.abs(glue.move((moved - skin).astype(np.float32)) - expected).max() < 0.2 * size


def test_a_lash_is_held_by_the_side_on_which_it_is_rooted():
    skin = np.array([[x, y, 0.0] for y in (0.0, 0.1) for x in np.linspace(0.0, 1.0, 20)])
    sides = (skin[:, 1] > 0.05).astype(int)
    lash = np.array([[0.5, 0.03, 0.0], [0.5, 0.03, -0.2]])
    glue = Glue(lash, Roots.by_nearest(np.array([0, 0])), skin, sides, 1.0)
    displacements = np.zeros((40, 3), dtype=np.float32)
    displacements[sides == 1, 1] = 1.0
    np.testing.assert_allclose(glue.move(displacements), lash, atol=1e-6)


def test_the_wall_of_a_mouth_is_shifted_but_not_rotated():
    skin = np.array([[x, y, 0.0] for y in (0.0, 0.1) for x in np.linspace(0.0, 1.0, 20)])
    wall = np.array([[0.5, 0.05, 0.4]])
    roots = Roots.by_nearest(np.array([0]))
    bent = np.float32([[0.0, 0.0, x] for x in skin[:, 0]])
    rotated = Glue(wall, roots, skin, np.zeros(40, dtype=int), 1.0).move(bent)
    shifted = Glue(wall, replace(roots, walls=np.array([True])), skin, np.zeros(40, dtype=int), 1.0).move(bent)
    assert abs(rotated[0, 0] - 0.5) > 0.2
    np.testing.assert_allclose(shifted, [[0.5, 0.05, 0.9]], atol=0.05)


@given(st.integers(0, 100))
def test_points_close_to_a_coarse_skin_stay_above_it_however_it_moves(seed):
    rng = np.random.default_rng(seed)
    grid = np.arange(6)
    skin = np.array([[0.2 * x, 0.2 * y, 0.0] for y in grid for x in grid])
    first = np.array([6 * y + x for y in grid[:-1] for x in grid[:-1]])
    faces = np.stack([first, first + 1, first + 7, first + 6], axis=1)
    strip = np.column_stack([np.linspace(0.1, 0.9, 50), np.linspace(0.3, 0.6, 50), np.full(50, -0.004)])
    roots, sides = Roots.by_nearest(np.arange(50)), np.zeros(36, dtype=int)
    moved = np.float32(rng.normal(scale=0.03, size=36)[:, None] * (0.0, 0.0, 1.0))
    corners, shares, away = nearest_triangles(strip, skin, triangulate(faces))
    np.testing.assert_allclose(away, 0.004, atol=1e-7)
    np.testing.assert_allclose((shares[..., None] * skin[corners]).sum(axis=1)[:, :2], strip[:, :2], atol=1e-7)
    beneath = (shares[..., None] * moved[corners]).sum(axis=1)[:, 2]
    off = [
        np.abs(beneath - Glue(strip, roots, skin, sides, 1.0, faces=of).move(moved)[:, 2] - 0.004).max()
        for of in (faces, None)
    ]
    assert off[0] < 0.003 and off[0] < off[1]


def test_a_root_is_held_by_the_side_that_is_stated_unless_that_is_far_away():
    skin = np.array([[x, y, 0.0] for y in (0.0, 0.1) for x in np.linspace(0.0, 1.0, 50)])
    sides = (skin[:, 1] > 0.05).astype(int)
    point = np.array([[0.5, 0.03, 0.0]])
    raised = np.float32(np.where(sides[:, None] == 1, [0.0, 1.0, 0.0], 0.0))
    for side, moved in ((-1, 0.0), (0, 0.0), (1, 1.0), (2, 0.0)):
        roots = replace(Roots.by_nearest(np.array([0])), sides=np.array([side]), walls=np.array([True]))
        np.testing.assert_allclose(
            Glue(point, roots, skin, sides, 1.0).move(raised) - point, [[0.0, moved, 0.0]], atol=1e-6
        )


@pytest.mark.parametrize(("begin", "height"), [(0.0, 0.06), (0.05, 0.08)])
def test_a_line_of_lashes_on_the_lid_keeps_its_width_when_the_eye_shuts(begin, height):
    rig = built_in_head()
    eye, *_ = lid_rims(rig.vertices, rig.faces, rig.landmarks, rig.region_weights)
    rim = np.asarray(rig.vertices)[eye.upper.vertices[1:-1]]
    above = np.array([0.0, -height, 0.0]) * rig.eye_distance
    near = np.linalg.norm(np.asarray(rig.vertices)[:, None] - (rim + above), axis=2).argmin(axis=0)
    end = rim + above + (0.0, 0.0, 1.0) * (np.asarray(rig.vertices)[near] - rim - above)
    line = np.concatenate([rim + begin / height * (end - rim), end])
    start, n = len(rig.vertices), len(rim)
    faces = start + np.array([[i, i + 1, n + i + 1, n + i] for i in range(n - 1)])
    kinds = np.append(np.zeros(start, dtype=np.int8), np.full(len(line), Part.ON_SKIN, dtype=np.int8))
    lashed = replace(rig, parts=FaceParts(kinds, line.astype(np.float32), faces))
    alone, skin = lashed.skin()
    points, shutting = np.asarray(rig.vertices)[rig.landmarks], np.zeros((66, 3))
    shutting[UPPER_LIDS] = points[LOWER_LIDS] - points[UPPER_LIDS]
    shut = head_deformer(alone).deform(shutting)
    moved = PartDriver(lashed, skin, alone).pose(shut, np.eye(3), np.tile(np.eye(3), (2, 1, 1)))
    fallen = np.linalg.norm((moved - lashed.all_vertices)[eye.upper.vertices[1:-1]], axis=1) / rig.eye_distance
    assert fallen.max() > 0.05
    before, width = (np.linalg.norm(at[-n:] - at[-2 * n : -n], axis=1) for at in (lashed.all_vertices, moved))
    np.testing.assert_allclose(width, before, rtol=0.15)
    line_fell = np.linalg.norm((moved - lashed.all_vertices)[-2 * n : -n], axis=1) / rig.eye_distance
    np.testing.assert_allclose(line_fell, fallen, atol=0.02)


@given(st.floats(0.5, 2.0), st.integers(0, 100))
def test_the_sphere_of_an_eye_is_found_in_spite_of_its_cornea(radius, seed):
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(300, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ways = ways[ways[:, 2] < 0.3]
    bulge = 1.0 + 0.12 * np.clip((-ways[:, 2] - 0.9) / 0.1, 0.0, 1.0)
    eye = radius * ways * bulge[:, None] + (1.0, 2.0, 3.0)
    sphere, is_round = part_eyeball(eye)
    assert is_round
    np.testing.assert_allclose(sphere, [1.0, 2.0, 3.0, radius], atol=0.03 * radius)
    around = sphere_of_lids(eye)
    np.testing.assert_allclose(around, [1.0, 2.0, 3.0, radius * bulge.max()], atol=0.05 * radius)
    assert (np.linalg.norm(eye - around[:3], axis=1) < around[3] * (1.0 + 1e-9)).all(), "the lids pass over the cornea"


def test_a_flat_eye_is_not_taken_for_a_sphere():
    disc = np.array([[np.cos(a) * r, np.sin(a) * r, 0.0] for a in np.linspace(0, 6, 30) for r in (0.3, 0.7, 1.0)])
    sphere, is_round = part_eyeball(disc)
    assert not is_round and sphere_of_lids(disc) is None
    assert sphere[2] > 0.5


def test_eyes_turn_about_their_centres_lower_teeth_follow_the_jaw_and_upper_ones_stay():
    take, rig = performance(), with_parts()
    driver = HeadDriver(rig, calibrate(take))
    frame = max((driver.frame(take.result(i)) for i in np.flatnonzero(take.found)[::5]), key=lambda f: abs(f.jaw[1, 2]))
    rest, kinds = rig.all_vertices, rig.kinds
    assert frame.vertices.shape == rest.shape
    np.testing.assert_array_equal(frame.vertices[kinds == Part.TEETH_UPPER], rest[kinds == Part.TEETH_UPPER])
    lower = kinds == Part.TEETH_LOWER
    expected = rig.jaw_pivot + (rest[lower] - rig.jaw_pivot) @ frame.jaw.T
    np.testing.assert_allclose(frame.vertices[lower], expected, atol=1e-6)
    for side, kind in enumerate((Part.EYE_RIGHT, Part.EYE_LEFT)):
        centre = part_eyeball(rest[kinds == kind])[0][:3]
        turned = centre + (rest[kinds == kind] - centre) @ frame.gaze[side].T
        np.testing.assert_allclose(frame.vertices[kinds == kind], turned, atol=1e-6)
    first = int(np.flatnonzero(take.found)[0])
    plain = HeadDriver(built_in_head(), calibrate(take)).frame(take.result(first))
    np.testing.assert_allclose(
        driver.frame(take.result(first)).vertices[: len(plain.vertices)], plain.vertices, atol=1e-6
    )


def test_each_hair_of_a_brow_and_each_lash_keeps_its_shape_while_the_skin_stretches():
    head, rig = load_head(), built_in_head(lashes=True)
    alone, skin = rig.skin()
    driver = PartDriver(rig, skin, alone)
    unit = head.units[head.unit_names.index("browDownLeft")] + head.units[head.unit_names.index("eyeBlinkLeft")]
    moved = driver.pose(head.vertices + unit, np.eye(3), np.stack([np.eye(3)] * 2))
    faces = rig.parts.faces[:, :3]
    before, after = (
        np.linalg.norm(points[faces[:, 0]] - points[faces[:, 1:].T], axis=2) for points in (driver.rest, moved)
    )
    assert np.linalg.norm((moved - driver.rest)[faces], axis=2).max() > 0.005
    assert np.abs(after - before).max() < 0.0002
