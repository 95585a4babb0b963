"""Necks, limbs and clothes that reach up behind the chin are told by their names."""

import numpy as np
import pytest

from facemime.core.heads.built_in import load_head
from facemime.core.heads.part_names import names_below_face
from facemime.core.heads.rig import Part, built_in_head
from facemime.core.heads.sorting import Piece, sort_pieces


@pytest.mark.parametrize(
    "names",
    [("Hals",), ("skin", "cou_geo"), ("Material", "Character.Cuello.001"), ("首",), ("Skin", "NeckMesh"), ("Shirt",)],
)
def test_a_neck_or_collar_by_name_is_not_teeth_though_it_ends_above_the_chin(names):
    head, points = load_head(), built_in_head().vertices[built_in_head().landmarks].astype(np.float64)
    teeth = next(part.vertices for part in head.parts if part.name == "teeth_lower")
    assert sort_pieces([Piece(teeth, names, moving=False)], points) == [Part.ON_HEAD]
    assert sort_pieces([Piece(teeth, ("Teeth", *names), moving=False)], points) != [Part.ON_HEAD]


@pytest.mark.parametrize("name", ["body", "Body_skin", "mouth_bottom", "Necklace mouth", "coupe", "hair"])
def test_names_of_a_whole_body_or_of_the_mouth_leave_teeth_to_their_place(name):
    assert not names_below_face(name)


@pytest.mark.parametrize("name", ["Шея", "шея_mesh", "pescoço", "頸", "脖子", "Neck.002", "Kark_base"])
def test_necks_are_known_in_other_scripts_and_with_endings(name):
    assert names_below_face(name)
