"""Files of takes: removing, finding, packing, exporting, and moving the .blend file."""

import os
from pathlib import Path

import bpy
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.takes.file import save_take
from facemime.settings import takes_store
from tests.helpers.takes import performance

pytestmark = pytest.mark.usefixtures("in_a_project")


def test_a_removed_take_stays_on_disk_and_can_be_found_again(imported, takes, tmp_path):
    assert bpy.ops.facemime.trim_take(start=0.4, end=1.6) == {"FINISHED"}
    path = Path(bpy.path.abspath(takes.items[1].path))
    for _ in range(2):
        assert bpy.ops.facemime.remove_take() == {"FINISHED"}
    assert path.is_file() and not len(takes.items) and not bpy.ops.facemime.remove_take.poll()
    assert bpy.ops.facemime.find_takes() == {"FINISHED"}
    assert [line.path for line in takes.items] == ["//takes/First_Trimmed.facetake"]
    assert bpy.ops.facemime.find_takes() == {"FINISHED"} and len(takes.items) == 1


def test_a_packed_take_needs_no_file_and_can_be_unpacked(imported, tmp_path):
    assert bpy.ops.facemime.pack_take() == {"FINISHED"}
    (tmp_path / "First.facetake").unlink()
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    line = bpy.context.scene.facemime_takes.items[0]
    np.testing.assert_allclose(takes_store.read(line).times, performance().times)
    assert bpy.ops.facemime.pack_take() == {"FINISHED"}
    assert line.packed is None and not bpy.data.texts and (tmp_path / "takes" / "First.facetake").is_file()


def test_unpacking_a_take_keeps_it_in_a_full_copy_of_the_scene(imported, takes, tmp_path):
    assert bpy.ops.facemime.pack_take() == {"FINISHED"}
    (tmp_path / "First.facetake").unlink()
    assert bpy.ops.scene.new(type="FULL_COPY") == {"FINISHED"}
    copied = bpy.context.scene.facemime_takes.items[0]
    takes_store.unpack(copied)
    for line in (copied, takes.items[0]):
        assert len(takes_store.read(line)) == len(performance())
    takes_store.unpack(takes.items[0])
    assert not bpy.data.texts


def test_problems_with_a_take_are_reported(imported, tmp_path):
    (tmp_path / "First.facetake").unlink()
    with pytest.raises(RuntimeError, match="is missing"):
        bpy.ops.facemime.export_take(filepath=str(tmp_path / "out.facetake"))
    imported.packed = bpy.data.texts.new("rubbish")
    with pytest.raises(RuntimeError, match="is damaged"):
        bpy.ops.facemime.export_take(filepath=str(tmp_path / "out.facetake"))
    with pytest.raises(RuntimeError, match="no take"):
        bpy.ops.facemime.import_take(filepath=str(tmp_path / "none.facetake"))


def test_takes_are_exported_and_imported_as_files_and_tables(imported, takes, tmp_path):
    for suffix in ("csv", "facetake"):
        assert bpy.ops.facemime.export_take(filepath=str(tmp_path / f"out.{suffix}")) == {"FINISHED"}
        assert bpy.ops.facemime.import_take(filepath=str(tmp_path / f"out.{suffix}")) == {"FINISHED"}
        takes.index = 0
    for line in takes.items[1:]:
        np.testing.assert_allclose(takes_store.read(line).shape, takes_store.read(takes.items[0]).shape)
    assert [line.path for line in takes.items[1:]] == ["//takes/out.facetake", "//out.facetake"]


def test_takes_of_an_unsaved_file_are_in_the_users_documents():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert takes_store.folder().is_absolute() and takes_store.folder().name == "takes"
    assert takes_store.folder().parent.name == "Facemime"


def test_a_file_saved_elsewhere_or_as_a_copy_finds_its_takes(imported, tmp_path):
    (tmp_path / "other").mkdir()
    for name, copy in (("copy.blend", True), ("moved.blend", False)):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other" / name), copy=copy)
        assert imported.path == ("//First.facetake" if copy else "//../First.facetake")
        assert len(takes_store.read(imported)) == 60
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other" / "copy.blend"))
    assert len(takes_store.read(bpy.context.scene.facemime_takes.items[0])) == 60


def test_the_path_of_a_take_becomes_relative_when_the_file_is_saved(tmp_path):
    save_take(performance(), tmp_path / "First.facetake")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.facemime.import_take(filepath=str(tmp_path / "First.facetake"))
    line = bpy.context.scene.facemime_takes.items[0]
    assert line.path == str(tmp_path / "First.facetake")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "late.blend"))
    assert line.path == "//First.facetake"


@pytest.mark.parametrize(
    "text", ["Größe;1,5\n".encode("cp1252"), "frame,x\n".encode("utf-16")], ids=["cp1252", "utf-16"]
)
def test_tables_of_another_encoding_are_one_error_each(in_a_project, tmp_path, text):
    add_head(bpy.context)
    for name, suffix in (("import_take", ".csv"), ("import_key_map", ".json"), ("import_preset", ".json")):
        path = tmp_path / f"odd{suffix}"
        path.write_bytes(text)
        with pytest.raises(RuntimeError) as caught:
            getattr(bpy.ops.facemime, name)(filepath=str(path))
        assert str(caught.value).startswith("Error: ") and "Traceback" not in str(caught.value)


@pytest.mark.skipif(os.name != "nt", reason="Windows alone refuses such names")
@pytest.mark.parametrize(
    ("name", "suffix"),
    [
        *(("import_take", ".facetake"), ("import_take", ".csv"), ("import_facegen", ".tri"), ("puppet_video", ".mp4")),
        *(("import_key_map", ".json"), ("import_preset", ".json"), ("export_preset", ".json")),
    ],
)
def test_names_that_windows_refuses_are_one_error_each(in_a_project, tmp_path, name, suffix):
    add_head(bpy.context)
    with pytest.raises(RuntimeError) as caught:
        getattr(bpy.ops.facemime, name)(filepath=str(tmp_path / f"what?{suffix}"))
    assert str(caught.value).startswith("Error: ") and "Traceback" not in str(caught.value)


def test_invalid_names_and_endless_files_are_one_error_each(in_a_project, takes, tmp_path):
    (tmp_path / "takes").mkdir()
    save_take(performance(), tmp_path / "takes" / "good.facetake")
    try:
        odd = Path(os.fsdecode(os.fsencode(tmp_path / "takes") + b"/a\xff.facetake"))
        save_take(performance(), odd)
        (tmp_path / "takes" / "loop.facetake").symlink_to("loop.facetake")
        os.mkfifo(tmp_path / "endless.json")
    except (OSError, AttributeError, NotImplementedError, UnicodeDecodeError):
        pytest.skip("this system has no such names, links and pipes")
    for path in (tmp_path / ("x" * 300), odd.with_suffix("")):
        for name, suffix in (
            ("import_take", ".facetake"),
            ("import_take", ".csv"),
            ("import_facegen", ".tri"),
            ("import_key_map", ".json"),
            ("import_preset", ".json"),
            ("puppet_video", ".mp4"),
        ):
            add_head(bpy.context)
            with pytest.raises(RuntimeError, match=r"^Error: .*(file name too long|is not valid UTF-8)"):
                getattr(bpy.ops.facemime, name)(filepath=f"{path}{suffix}")
    with pytest.raises(RuntimeError, match="is not a file but a pipe"):
        bpy.ops.facemime.import_key_map(filepath=str(tmp_path / "endless.json"))
    assert bpy.ops.facemime.find_takes() == {"FINISHED"}
    assert [line.name for line in takes.items] == ["good"]
    takes.items[0].path = str(tmp_path / ("x" * 300))
    with pytest.raises(RuntimeError, match="Restore it, or import it again"):
        bpy.ops.facemime.export_take(filepath=str(tmp_path / "out.facetake"))
