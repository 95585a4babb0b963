"""Levels of detail in the names of meshes, as games and engines write them."""

import pytest

from facemime.core.heads.part_names import level_of_detail


@pytest.mark.parametrize(
    ("name", "level"),
    [
        ("Head_LOD0", ("Head", 0)),
        ("head_lod3_mesh", ("head_mesh", 3)),
        ("SK_Mannequin_LOD 1", ("SK_Mannequin", 1)),
        ("BodyLod2", ("Body", 2)),
        ("LOD_1", ("", 1)),
        ("Hair.LOD1.002", ("Hair", 1)),
        ("Melod1", None),
        ("LOD.001", None),
        ("Head", None),
        ("EXPLOD1", None),
    ],
)
def test_levels_of_detail_are_told_by_name(name, level):
    assert level_of_detail(name) == level
