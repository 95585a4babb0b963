"""FaceGen's files: read as PyFFI reads them, and refused with the place where they are broken."""

import io
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facegen_files import DIFFERENCE, OBJ, QUADS, TARGETS, TRIANGLES, UVS, VERTICES, egm, tri
from facemime.core.errors import SourceError
from facemime.core.facegen import read_egm, read_obj, read_tri

HEAD = np.array([1, -1, -1], np.float32)


@pytest.fixture
def write(tmp_path):
    """Write bytes or text to a file of that name."""

    def _write(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return _write


@pytest.fixture
def pyffi(monkeypatch):
    """PyFFI's two formats; it dates from a Python that had `time.clock`. `requirements/oracles.txt` installs it."""
    monkeypatch.setattr(time, "clock", time.perf_counter, raising=False)
    tri_format = pytest.importorskip("pyffi.formats.tri").TriFormat
    egm_format = pytest.importorskip("pyffi.formats.egm").EgmFormat
    return tri_format, egm_format


def test_a_tri_gives_its_mesh_and_its_morphs(write):
    mesh = read_tri(write("head.tri", tri()))
    np.testing.assert_array_equal(mesh.vertices, VERTICES * HEAD)
    np.testing.assert_array_equal(mesh.faces, [[*TRIANGLES[0], -1], QUADS[0]])
    np.testing.assert_array_equal(mesh.uv[1], UVS[QUADS[0]])
    names = [name for name, _ in mesh.morphs]
    assert names == ["Smile", "Wide", "Deep"]
    offsets = dict(mesh.morphs)
    np.testing.assert_allclose(offsets["Smile"], 0.01 * DIFFERENCE * HEAD, rtol=1e-6)
    np.testing.assert_allclose(VERTICES[[3, 0]] * HEAD + offsets["Wide"][[3, 0]], TARGETS[:2] * HEAD)
    assert not offsets["Deep"][:4].any()


def test_labels_and_texture_by_vertex_are_read(write):
    mesh = read_tri(write("head.tri", tri(labels=True, per_vertex_uv=True)))
    assert mesh.labels == {"nose": 3}
    np.testing.assert_array_equal(mesh.uv[0, :3], UVS[TRIANGLES[0]])
    assert len(mesh.morphs) == 3


def test_an_egm_gives_the_modes_of_the_meshs_own_vertices(write):
    modes = read_egm(write("head.egm", egm()), read_tri(write("head.tri", tri())))
    assert [name for name, _ in modes] == ["Symmetric 01", "Symmetric 02", "Asymmetric 01"]
    np.testing.assert_allclose(modes[0][1], 0.5 * np.arange(15).reshape(5, 3) * HEAD)


def test_pyffi_reads_the_same_from_a_tri(write, pyffi):
    data = pyffi[0].Data()
    data.read(io.BytesIO(tri()))
    mesh = read_tri(write("head.tri", tri()))
    np.testing.assert_allclose([[v.x, v.y, v.z] for v in data.vertices] * HEAD, mesh.vertices)
    np.testing.assert_array_equal([[f.v_1, f.v_2, f.v_3] for f in data.tri_faces], mesh.faces[:1, :3])
    for morph, (name, offsets) in zip(data.morphs, mesh.morphs[:1], strict=True):
        assert morph.name.decode().rstrip("\0") == name
        np.testing.assert_allclose(np.array(list(morph.get_relative_vertices())) * HEAD, offsets, rtol=1e-5)
    for modifier, (name, offsets) in zip(data.modifiers, mesh.morphs[1:], strict=True):
        assert modifier.name.decode().rstrip("\0") == name
        rows = list(modifier.vertices_to_modify)
        moved = np.array([[v.x, v.y, v.z] for v in modifier.modifier_vertices]) * HEAD
        np.testing.assert_allclose(mesh.vertices[rows] + offsets[rows], moved)


def test_pyffi_reads_the_same_from_an_egm(write, pyffi):
    data = pyffi[1].Data()
    data.read(io.BytesIO(egm()))
    modes = read_egm(write("head.egm", egm()), read_tri(write("head.tri", tri())))
    theirs = [*data.sym_morphs, *data.asym_morphs]
    for morph, (_, offsets) in zip(theirs, modes, strict=True):
        values = np.array([[v.x, v.y, v.z] for v in morph.vertices][:5], float)
        np.testing.assert_allclose(values * morph.scale * HEAD, offsets)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(tri()) - 1))
def test_a_tri_that_ends_early_is_refused_with_the_place(tmp_path_factory, length):
    path = tmp_path_factory.mktemp("cut") / "head.tri"
    path.write_bytes(tri()[:length])
    with pytest.raises(SourceError, match=r"byte \d+"):
        read_tri(path)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, len(tri()) - 1), st.integers(0, 255))
def test_a_changed_byte_gives_a_mesh_or_a_plain_refusal(tmp_path_factory, place, value):
    content = bytearray(tri())
    content[place] = value
    path = tmp_path_factory.mktemp("changed") / "head.tri"
    path.write_bytes(bytes(content))
    try:
        mesh = read_tri(path)
    except SourceError as error:
        assert "byte" in str(error)
    else:
        assert mesh.faces.max() < len(mesh.vertices)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"nothing of the kind", "no FRTRI file"),
        (b"FRTRI103" + tri()[8:], "version 103"),
        (tri() + b"more", "4 bytes follow"),
        (tri()[:64] + b"\xff\xff\xff\x7f" + tri()[68:], "not finite"),
    ],
)
def test_what_is_no_sound_tri_is_refused(write, content, message):
    with pytest.raises(SourceError, match=message):
        read_tri(write("head.tri", content))


def test_an_egm_of_another_mesh_is_refused(write):
    mesh = read_tri(write("head.tri", tri()))
    with pytest.raises(SourceError, match="for a mesh of 4 vertices, this one has 5"):
        read_egm(write("head.egm", egm(4)), mesh)


def test_an_obj_keeps_the_files_order(write):
    mesh = read_obj(write("head.obj", OBJ))
    np.testing.assert_array_equal(mesh.vertices, VERTICES * HEAD)
    assert mesh.faces.tolist() == [[0, 1, 2, 3], [1, 4, 2, -1], [0, 1, 4, -1], [0, 4, 2, -1], [0, 2, 3, -1]]
    np.testing.assert_array_equal(mesh.uv[0], [[0, 0], [1, 0], [1, 1], [0, 0]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("v 0 0 0\nf 1 2 3\n", "line 2"),
        ("v 0 zero 0\n", "line 1"),
        ("v 0 0 0\n", "no mesh"),
        ("v 0 0 0\nf 1\n", "line 2"),
    ],
)
def test_a_broken_obj_is_refused_with_its_line(write, content, message):
    with pytest.raises(SourceError, match=message):
        read_obj(write("head.obj", content))


def test_a_missing_file_is_told(tmp_path):
    for read, name in ((read_tri, "none.tri"), (read_obj, "none.obj")):
        with pytest.raises(SourceError, match="cannot be read"):
            read(tmp_path / name)
