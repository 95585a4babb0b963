"""The converter of ICT-FaceKit's published files, tested with a mesh in the same layout."""

import json

import numpy as np
import pytest

from lab.training.data import DATA, ICT_FILE, has_heads
from lab.training.ict import USED, checksum, convert

POINTS = np.array([[0.0, -2.48251, 11.8387], [0.0, 1.0, 11.5], [1.0, 1.0, 11.4], [1.0, -2.0, 11.2], [2.0, 0.0, 9.0]])
FACES = ["usemtl M_Face", "f 1/1 2/2 3/3 4/4", "usemtl M_BackHead", "f 4/4 3/3 5/5"]


def write(path, points, faces=FACES):
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += [f"vt {0.1 * i:.6f} 0.500000" for i in range(5)]
    path.write_text("\n".join(["mtllib ICTFaceModelMaterial.mtl", *lines, *faces]) + "\n")


@pytest.fixture
def published(tmp_path):
    write(tmp_path / "generic_neutral_mesh.obj", POINTS)
    write(tmp_path / "identity000.obj", POINTS + [0.25, 0.0, 0.0])
    write(tmp_path / "identity001.obj", POINTS * 1.5)
    write(tmp_path / "jawOpen.obj", POINTS + [0.0, -1.0, 0.0])
    (tmp_path / "vertex_indices.json").write_text(json.dumps({"idx_to_landmark_verts": [3, 1, 2]}))
    return tmp_path


def test_identities_and_expressions_are_differences_from_the_neutral_mesh(published):
    arrays = convert(published)
    assert np.allclose(arrays["neutral"], POINTS, atol=1e-5)
    assert arrays["identity_names"].tolist() == ["identity000", "identity001"]
    assert np.allclose(arrays["identity_delta"], [np.tile([0.25, 0.0, 0.0], (5, 1)), 0.5 * POINTS], atol=3e-3)
    assert arrays["expression_names"].tolist() == ["jawOpen"]
    assert np.allclose(arrays["expression_delta"][0], [0.0, -1.0, 0.0])


def test_faces_count_from_zero_and_know_their_material(published):
    arrays = convert(published)
    assert arrays["faces"].tolist() == [[0, 1, 2, 3], [3, 2, 4, -1]]
    assert arrays["faces_uv"].tolist() == [[0, 1, 2, 3], [3, 2, 4, -1]]
    assert arrays["materials"][arrays["face_material"]].tolist() == ["M_Face", "M_BackHead"]
    assert arrays["landmarks68"].tolist() == [3, 1, 2]


def test_a_mesh_with_other_vertices_is_refused_by_name(published):
    write(published / "jawOpen.obj", POINTS[:4], FACES[:2])
    with pytest.raises(ValueError, match=r"jawOpen\.obj has 4 vertices, and the neutral mesh has 5"):
        convert(published)


def test_the_checksum_tells_another_order_of_vertices_apart(published):
    arrays = convert(published)
    other = arrays | {"neutral": arrays["neutral"][::-1]}
    assert checksum(arrays) == checksum(convert(published)) != checksum(other)


@pytest.mark.skipif(not has_heads(DATA), reason="../shared/data/heads is missing")
def test_the_models_were_trained_with_the_version_that_is_named():
    assert checksum(dict(np.load(DATA / ICT_FILE))) == USED
