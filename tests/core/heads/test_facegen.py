"""FaceGen files are read as PyFFI reads them, and damaged ones are refused with the position."""

import io
import struct
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facemime.core.bake.key_sets import KEY_SETS
from facemime.core.errors import SourceError
from facemime.core.face.names import normalised
from facemime.core.files.assets import ASSETS
from facemime.core.heads.built_in import load_head
from facemime.core.heads.facegen import read_egm, read_obj, read_tri
from facemime.core.heads.key_presets import best_preset, known_expressions
from tests.helpers.facegen_files import DIFFERENCE, OBJ, QUADS, TARGETS, TRIANGLES, UVS, VERTICES, egm, tri

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
    """PyFFI's two formats, from `tools/requirements/oracles.txt`; PyFFI needs `time.clock`, which Python has
    removed.
    """
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
    assert mesh.labels == {"nose": 3, "cheek": 1}
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


def test_a_whole_head_that_pyffi_wrote_is_read(write, pyffi):
    head, units = load_head(), KEY_SETS["facegen"].mixtures
    rest = head.vertices * HEAD
    moved = np.einsum("ku,uvc->kvc", units, head.units) * HEAD
    modes = [0.01 * np.random.default_rng(seed).normal(size=rest.shape) for seed in range(4)]
    eyes = np.flatnonzero(np.abs(moved).max(axis=(0, 2)) > 0.005)[:40]
    mesh = read_tri(write("head.tri", pyffi_tri(pyffi[0], head, moved, eyes)))
    read = read_egm(write("head.egm", pyffi_egm(pyffi[1], modes, len(eyes))), mesh)
    np.testing.assert_allclose(mesh.vertices, head.vertices, atol=1e-7)
    assert [[*face] for face in mesh.faces if face[3] >= 0] == [[*face] for face in head.faces if face[3] >= 0]
    names = [*KEY_SETS["facegen"].names, "Look"]
    assert [name for name, _ in mesh.morphs] == names
    for (_, offsets), true in zip(mesh.morphs, moved * HEAD, strict=False):
        np.testing.assert_allclose(offsets, true, atol=2e-6)
    look = dict(mesh.morphs)["Look"]
    np.testing.assert_allclose(look[eyes], np.tile([0.0, -0.01, 0.0], (len(eyes), 1)), atol=1e-6)
    assert not np.delete(look, eyes, axis=0).any()
    for (_, offsets), true in zip(read, modes, strict=True):
        np.testing.assert_allclose(offsets, true * HEAD, atol=2e-6)


def pyffi_tri(formats, head, moved, rows):
    """A head with FaceGen's 37 difference morphs and a statistical morph of `rows` vertices, as written by PyFFI."""
    quads, triangles = head.faces[head.faces[:, 3] >= 0], head.faces[head.faces[:, 3] < 0, :3]
    data = formats.Data()
    data.num_vertices, data.num_tri_faces, data.num_quad_faces = len(head.vertices), len(triangles), len(quads)
    for part in (data.vertices, data.tri_faces, data.quad_faces):
        part.update_size()
    fill(data.vertices, "xyz", head.vertices * HEAD)
    fill(data.tri_faces, ("v_1", "v_2", "v_3"), triangles)
    fill(data.quad_faces, ("v_1", "v_2", "v_3", "v_4"), quads)
    for name, offsets in zip(KEY_SETS["facegen"].names, moved, strict=True):
        morph = data.add_morph()
        morph.name, morph.arg = name.encode(), len(offsets)
        morph.vertices.update_size()
        morph.set_relative_vertices(offsets.tolist())
    look = data.add_modifier()
    look.name, look.num_vertices_to_modify = b"Look", len(rows)
    look.vertices_to_modify.update_size()
    look.modifier_vertices.update_size()
    for i, row in enumerate(rows):
        look.vertices_to_modify[i] = int(row)
    fill(look.modifier_vertices, "xyz", head.vertices[rows] * HEAD + [0.0, 0.01, 0.0])
    out = io.BytesIO()
    data.write(out)
    return out.getvalue()


def pyffi_egm(formats, modes, more):
    """Modes of face space, half of them asymmetric, with `more` vertices of statistical morphs."""
    data = formats.Data(num_vertices=len(modes[0]) + more)
    for number, offsets in enumerate(modes):
        morph = data.add_sym_morph() if number < len(modes) // 2 else data.add_asym_morph()
        morph.set_relative_vertices([*offsets.tolist(), *np.zeros((more, 3)).tolist()])
    out = io.BytesIO()
    data.write(out)
    return out.getvalue()


def fill(records, names, rows):
    for record, row in zip(records, np.asarray(rows).tolist(), strict=True):
        for name, value in zip(names, row, strict=True):
            setattr(record, name, value)


@settings(max_examples=60)
@given(st.integers(0, len(tri()) - 1))
def test_a_truncated_tri_is_refused_with_the_position(tmp_path_factory, length):
    path = tmp_path_factory.mktemp("cut") / "head.tri"
    path.write_bytes(tri()[:length])
    with pytest.raises(SourceError, match=r"byte \d+"):
        read_tri(path)


@settings(max_examples=100)
@given(st.integers(0, len(tri()) - 1), st.integers(0, 255))
def test_a_changed_byte_gives_a_mesh_or_a_clear_error(tmp_path_factory, place, value):
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
        (b"nothing of the kind", "not a FRTRI file"),
        (b"FRTRI103" + tri()[8:], "version 103"),
        (tri() + b"more", "4 bytes follow"),
        (tri()[:64] + b"\xff\xff\xff\x7f" + tri()[68:], "not finite"),
    ],
)
def test_invalid_tri_files_are_refused(write, content, message):
    with pytest.raises(SourceError, match=message):
        read_tri(write("head.tri", content))


def test_an_egm_for_another_mesh_is_refused(write):
    mesh = read_tri(write("head.tri", tri()))
    with pytest.raises(SourceError, match="a mesh with 4 vertices; this one has 5"):
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


def test_a_missing_file_is_reported(tmp_path):
    for read, name in ((read_tri, "none.tri"), (read_obj, "none.obj")):
        with pytest.raises(SourceError, match="cannot be read"):
            read(tmp_path / name)


def morphs(vertices: int, differences: int, statistical: int) -> bytes:
    """A `.tri` of a flat mesh with empty statistical morphs."""
    header = [vertices, 1, 0, 0, 0, 0, 0, differences, statistical, 0, 0, 0, 0, 0]
    places = np.random.default_rng(1).random((vertices, 3), np.float32)
    out = b"FRTRI003" + struct.pack("<14i", *header) + places.tobytes() + np.array([0, 1, 2], np.int32).tobytes()
    one = struct.pack("<i", 1) + b"\0" + struct.pack("<f", 1.0) + bytes(6 * vertices)
    return out + one * differences + (struct.pack("<i", 1) + b"\0" + struct.pack("<i", 0)) * statistical


@pytest.mark.parametrize(("vertices", "differences", "statistical"), [(20_000, 0, 40_000), (15, 5000, 0)])
def test_too_many_morphs_are_refused_before_memory_is_allocated(write, vertices, differences, statistical):
    path = write("head.tri", morphs(vertices, differences, statistical))
    tracemalloc.start()
    with pytest.raises(SourceError, match="more than any head has"):
        read_tri(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * path.stat().st_size + (4 << 20)


def test_as_many_morphs_as_a_head_has_are_read(write):
    assert len(read_tri(write("head.tri", morphs(20_000, 50, 250))).morphs) == 300


def test_an_egm_that_claims_too_many_modes_is_refused_at_once(write):
    mesh = read_tri(write("head.tri", tri()))
    claim = egm()[:12] + struct.pack("<2i", 50_000_000, 50_000_000) + egm()[20:164]
    tracemalloc.start()
    with pytest.raises(SourceError, match="more than any head has"):
        read_egm(write("head.egm", claim), mesh)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20


@pytest.mark.parametrize(
    ("number", "what"), [(np.nan, "not finite"), (np.inf, "not finite"), (1e30, "too far"), (-1e12, "too far")]
)
def test_a_tri_with_infinite_vertices_is_refused(write, number, what):
    content = tri()[:64] + struct.pack("<f", number) + tri()[68:]
    with pytest.raises(SourceError, match=what):
        read_tri(write("head.tri", content))


def test_a_morph_that_moves_to_infinity_is_refused(write):
    content = tri().replace(struct.pack("<f", 0.01), struct.pack("<f", 3e38))
    with pytest.raises(SourceError, match="moves too far"):
        read_tri(write("head.tri", content))


@pytest.mark.parametrize("line", ["v nan 0 0", "v inf 0 0", "v 1e39 0 0", "v 0 0", "vt nan 0", "vt 0"])
def test_an_obj_with_infinite_vertices_is_refused_with_the_line(write, line):
    with pytest.raises(SourceError, match="line 2"):
        read_obj(write("head.obj", f"# first\n{line}\n{OBJ}"))


def test_degenerate_and_duplicate_faces_are_dropped(write):
    """Blender's Subdivide crashes on degenerate faces, and never ends on duplicates."""
    odd = "f 1 1 1\nf 2 2 3\nf 1 2 1 3\nf 5 5 5 5\nf 2/2 5/1 3/3\n"
    mesh = read_obj(write("head.obj", OBJ + odd))
    np.testing.assert_array_equal(mesh.faces, read_obj(write("head.obj", OBJ)).faces)


def test_a_quad_with_a_side_of_length_zero_becomes_a_textured_triangle(write):
    lines = OBJ.splitlines()[:9]
    for face in ("f 1/1 1/1 2/2 3/3", "f 1/1 2/2 2/2 3/3", "f 1/1 2/2 3/3 3/3", "f 1/1 2/2 3/3 1/1"):
        mesh = read_obj(write("head.obj", "\n".join([*lines, face])))
        assert sorted(mesh.faces[0].tolist()) == [-1, 0, 1, 2] and mesh.faces[0, 3] == -1
        np.testing.assert_array_equal(mesh.uv[0, :3], UVS[mesh.faces[0, :3]])


@pytest.mark.parametrize("faces", ["f 1 1 1\n", "f 1 2 1 3\n", "f 6 7 8\n", "f 9 9 10\n"])
def test_a_mesh_without_any_area_is_refused(write, faces):
    flat = "v 0 0 0\nv 0 0 0\nv 0 0 0\nv 1 1 1\nv 2 2 2\n"
    with pytest.raises(SourceError, match="none of its faces has an area"):
        read_obj(write("head.obj", OBJ[: OBJ.index("vt")] + flat + faces))


def test_a_label_ends_at_its_null_character(write):
    """Blender does not accept names that contain a null character."""
    content = tri().replace(b"Smile", b"Sm\0le")
    assert read_tri(write("head.tri", content)).morphs[0][0] == "Sm"


def test_an_index_of_many_digits_is_shortened_in_the_message(write):
    with pytest.raises(SourceError, match="line 1") as caught:
        read_obj(write("head.obj", "f 1 2 " + "9" * 3000))
    assert len(str(caught.value)) < 300


def test_a_real_heads_labelled_points_become_the_nearest_vertices():
    jane = read_tri(ASSETS / "facegen" / "Jane.tri")
    assert jane.vertices.shape == (5850, 3) and len(jane.morphs) == 100
    assert set(jane.labels) == {"Nose Tip", "Exocanthion Right", "Mouth Corner Left", "Nare Left"}
    tip = jane.vertices[jane.labels["Nose Tip"]]
    assert tip[2] < np.quantile(jane.vertices[:, 2], 0.02)  # the nose protrudes


def test_a_labelled_point_on_a_face_that_does_not_exist_is_damage(tmp_path):
    data = bytearray(tri(labels=True))
    at = data.index(b"cheek") - 4 - 16
    data[at : at + 4] = (99).to_bytes(4, "little")
    (tmp_path / "head.tri").write_bytes(data)
    with pytest.raises(SourceError, match="a labelled point with an index outside 0 to 2"):
        read_tri(tmp_path / "head.tri")


def test_the_morphs_of_a_real_head_are_recognised():
    names = list(dict.fromkeys(name for name, _ in read_tri(ASSETS / "facegen" / "Jane.tri").morphs))
    found = best_preset(names)
    assert found.name == "FaceGen" and len(found.sources) == 51
    assert set(names) - set(known_expressions(names)) == {"Modifier: Ears Out", "Modifier: Epicanthic Fold"}
    assert normalised("Phoneme: R") == "r" and normalised("Modifier: Blink R") == "blinkright"
