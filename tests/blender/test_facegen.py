"""Import of FaceGen heads."""

import bpy
import numpy as np
import pytest

from tests.helpers.facegen_files import OBJ, UVS, VERTICES, egm, tri


def test_a_tri_and_the_egm_beside_it_become_a_mesh_with_shape_keys(tmp_path):
    (tmp_path / "head.tri").write_bytes(tri())
    (tmp_path / "head.egm").write_bytes(egm())
    assert bpy.ops.facemime.import_facegen(filepath=str(tmp_path / "head.tri"), scale=1.0) == {"FINISHED"}
    obj = bpy.context.active_object
    upright = VERTICES[:, [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_allclose([v.co for v in obj.data.vertices], upright, atol=1e-6)
    assert [len(p.vertices) for p in obj.data.polygons] == [3, 4]
    assert [key.name for key in obj.data.shape_keys.key_blocks] == [
        *("Basis", "Smile", "Wide", "Deep"),
        *("Symmetric 01", "Symmetric 02", "Asymmetric 01"),
    ]
    assert all(key.value == 0.0 for key in obj.data.shape_keys.key_blocks[1:])
    np.testing.assert_allclose([uv.uv for uv in obj.data.uv_layers[0].data][3:], UVS[:4])


def test_an_obj_keeps_its_vertex_order(tmp_path):
    (tmp_path / "head.obj").write_text(OBJ)
    assert bpy.ops.facemime.import_facegen(filepath=str(tmp_path / "head.obj")) == {"FINISHED"}
    found = np.array([v.co for v in bpy.context.active_object.data.vertices])
    np.testing.assert_allclose(found, VERTICES[:, [0, 2, 1]] * [1, -1, 1] * 0.001, atol=1e-6)


def test_a_damaged_file_is_reported_and_adds_nothing(tmp_path):
    (tmp_path / "head.tri").write_bytes(tri()[:100])
    with pytest.raises(RuntimeError, match="damaged at byte"):
        bpy.ops.facemime.import_facegen(filepath=str(tmp_path / "head.tri"))
    assert not bpy.data.objects


def test_degenerate_faces_do_not_reach_blender(tmp_path):
    """Blender's Subdivide crashes on a face of one vertex, and hangs on one with a repeated vertex."""
    (tmp_path / "head.obj").write_text(OBJ + "f 1 1 1\nf 2 2 3\nf 1 2 1 3\n")
    assert bpy.ops.facemime.import_facegen(filepath=str(tmp_path / "head.obj")) == {"FINISHED"}
    assert len(bpy.context.active_object.data.polygons) == 5
    assert not bpy.context.active_object.data.validate()
    bpy.ops.object.mode_set(mode="EDIT")
    assert bpy.ops.mesh.subdivide() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(bpy.context.active_object.data.polygons) > 5


def test_an_obj_without_area_is_reported_and_adds_nothing(tmp_path):
    (tmp_path / "head.obj").write_text(OBJ[: OBJ.index("f ")] + "f 1 1 1\n")
    with pytest.raises(RuntimeError, match="none of its faces has an area"):
        bpy.ops.facemime.import_facegen(filepath=str(tmp_path / "head.obj"))
    assert not bpy.data.objects
