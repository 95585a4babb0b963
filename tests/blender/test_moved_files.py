"""Takes, caches and presets are in folders of the user's, and move beside the .blend file at its first save."""

import shutil
from dataclasses import replace
from pathlib import Path

import bpy
import cv2
import numpy as np
import pytest

from facemime.blender.heads.new_heads import add_head
from facemime.core.takes.file import save_take
from facemime.settings import storage, takes_store
from facemime.settings import user_presets as presets
from facemime.settings.preferences import preferences
from tests.helpers.takes import performance

DOCUMENTS = storage.documents
"""The function that the fixtures replace."""


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Documents, presets and the extension's own folder, all empty."""
    monkeypatch.setattr(storage, "documents", lambda: tmp_path / "Documents")
    for module in (storage, storage):
        monkeypatch.setattr(module, "private_folder", lambda name: tmp_path / "extension" / name)
    for module in (presets, storage):
        monkeypatch.setattr(module, "presets_folder", lambda: tmp_path / "presets")
    return tmp_path


@pytest.fixture
def project(tmp_path) -> Path:
    (tmp_path / "project").mkdir()
    return tmp_path / "project"


def keep(name="Take"):
    return takes_store.keep(bpy.context.scene, performance(), name)


def save(path: Path, **options):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)


def slashes(path: str) -> str:
    """A path as Blender writes it on any system but Windows."""
    return path.replace("\\", "/")


def files(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_a_user_without_a_home_has_a_folder_for_takes(monkeypatch):
    def missing() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", missing)
    assert DOCUMENTS().is_dir()


def test_nothing_of_the_users_is_in_the_folder_that_is_deleted_with_the_extension(home):
    keep()
    assert bpy.ops.facemime.save_preset(name="Mine") == {"FINISHED"}
    shutil.rmtree(home / "extension", ignore_errors=True)
    assert len(takes_store.read(bpy.context.scene.facemime_takes.items[0])) == 60
    assert presets.names() == ["Mine"] and files(home / "Documents" / "Facemime") == ["takes/Take.facetake"]


def test_the_default_folder_of_presets_and_takes_is_not_the_extensions(monkeypatch):
    monkeypatch.undo()
    own = storage.private_folder("")
    for folder in (storage.user_folder("takes"), storage.user_folder("caches"), storage.presets_folder()):
        assert own not in (folder, *folder.parents)


def test_the_documents_are_where_the_desktop_says(tmp_path, monkeypatch):
    monkeypatch.setattr(storage.sys, "platform", "linux")
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    assert DOCUMENTS() == tmp_path
    (tmp_path / "Documents").mkdir()
    assert DOCUMENTS() == tmp_path / "Documents"
    (tmp_path / ".config").mkdir()
    (tmp_path / "Dokumente").mkdir()
    (tmp_path / ".config" / "user-dirs.dirs").write_text('# a comment\nXDG_DOCUMENTS_DIR="$HOME/Dokumente"\n')
    assert DOCUMENTS() == tmp_path / "Dokumente"


@pytest.mark.parametrize("preferred", [False, True])
def test_takes_and_their_videos_move_beside_the_file_at_its_first_save(home, project, preferred):
    if preferred:
        preferences().takes_folder = str(home / "chosen")
    try:
        line = keep()
        here = Path(line.path)
        assert here.parent == (home / "chosen" if preferred else home / "Documents" / "Facemime" / "takes")
        here.with_suffix(".mkv").write_bytes(b"video")
        clip = bpy.data.images.new("clip", 1, 1)
        clip.source, clip.filepath = "MOVIE", str(here.with_suffix(".mkv"))
        save(project / "shot.blend")
    finally:
        preferences().property_unset("takes_folder")
    assert files(project) == ["shot.blend", "takes/Take.facetake", "takes/Take.mkv"] and not here.exists()
    assert slashes(clip.filepath) == "//takes/Take.mkv"
    bpy.ops.wm.open_mainfile(filepath=str(project / "shot.blend"))
    (line,) = bpy.context.scene.facemime_takes.items
    assert line.path == "//takes/Take.facetake" and len(takes_store.read(line)) == 60


def test_a_cache_moves_with_its_modifier(home, project):
    cache = home / "Documents" / "Facemime" / "caches" / "Take.pc2"
    cache.parent.mkdir(parents=True)
    cache.write_bytes(b"cache")
    modifier = add_head(bpy.context).modifiers.new("Cache", "MESH_CACHE")
    modifier.filepath = str(cache)
    save(project / "shot.blend")
    assert slashes(modifier.filepath) == "//caches/Take.pc2" and Path(bpy.path.abspath(modifier.filepath)).is_file()


def test_a_saved_copy_has_takes_of_its_own_and_the_open_file_keeps_its(home, project):
    line = keep()
    here = line.path
    save(project / "copy.blend", copy=True)
    assert line.path == here and Path(here).is_file() and files(project) == ["copy.blend", "takes/Take.facetake"]
    bpy.ops.wm.open_mainfile(filepath=str(project / "copy.blend"))
    assert bpy.context.scene.facemime_takes.items[0].path == "//takes/Take.facetake"


def test_a_save_that_fails_moves_nothing(home, project):
    line = keep()
    here = line.path
    (project / "file").touch()
    with pytest.raises(RuntimeError):
        save(project / "file" / "shot.blend")
    assert line.path == here and len(takes_store.read(line)) == 60


def test_a_take_that_was_being_recorded_at_the_first_save_moves_when_it_ends(home, project):
    path = takes_store.new_path("Take")
    save_take(performance(), path)
    path.with_suffix(".mkv").write_bytes(b"video")
    assert storage.beside(path) == path
    save(project / "shot.blend")
    assert storage.beside(path) == project / "takes" / "Take.facetake" and not path.exists()
    assert files(project) == ["shot.blend", "takes/Take.facetake", "takes/Take.mkv"]
    assert storage.beside(home / "elsewhere.facetake") == home / "elsewhere.facetake"


def test_takes_and_caches_beside_which_nothing_can_be_written_are_in_the_default_folder(home, project, capfd):
    scene, head = bpy.context.scene, add_head(bpy.context)
    save(project / "shot.blend")
    for name in ("takes", "caches"):
        (project / name).write_text("not a folder, so nothing can be written in it, not even by root")
    line, before = keep(), files(project)
    assert Path(bpy.path.abspath(line.path)).resolve() == (home / "Documents/Facemime/takes/Take.facetake").resolve()
    assert storage.beside(storage.user_folder("takes") / "Take.facetake").is_relative_to(storage.user_folder("takes"))
    scene.facemime_takes.bake.keys = "cache"
    assert bpy.ops.facemime.bake_take() == {"FINISHED"}
    assert files(storage.user_folder("caches")) and files(project) == before
    cache = next(modifier for modifier in head.modifiers if modifier.type == "MESH_CACHE")
    assert Path(bpy.path.abspath(cache.filepath)).is_file()
    scene.facemime_takes.items.clear()
    assert bpy.ops.facemime.find_takes() == {"FINISHED"} and len(scene.facemime_takes.items) == 1
    assert "cannot be" not in capfd.readouterr().err
    (project / "takes").unlink()
    assert takes_store.folder() == project / "takes"


def test_takes_imported_from_elsewhere_stay_there(home, project):
    save_take(performance(), home / "other.facetake")
    assert bpy.ops.facemime.import_take(filepath=str(home / "other.facetake")) == {"FINISHED"}
    save(project / "shot.blend")
    assert (home / "other.facetake").is_file() and files(project) == ["shot.blend"]


def test_takes_of_another_file_in_the_same_folder_are_not_overwritten(home, project):
    (project / "takes").mkdir()
    (project / "takes" / "Take.facetake").write_bytes(b"another's")
    line = keep()
    save(project / "shot.blend")
    assert (project / "takes" / "Take.facetake").read_bytes() == b"another's"
    assert line.path == "//takes/shot/Take.facetake" and len(takes_store.read(line)) == 60


def test_undo_steps_from_before_the_first_save_find_the_takes(home, project):
    bpy.ops.ed.undo_push(message="before")
    keep()
    bpy.ops.ed.undo_push(message="recorded")
    keep("Second")
    bpy.ops.ed.undo_push(message="recorded another")
    save(project / "shot.blend")
    bpy.ops.ed.undo()
    (line,) = bpy.context.scene.facemime_takes.items
    assert line.path == "//takes/Take.facetake" and len(takes_store.read(line)) == 60


def test_an_upgrade_moves_takes_and_presets_out_of_the_extensions_folder(home, project):
    earlier = home / "extension" / "takes"
    earlier.mkdir(parents=True)
    (home / "extension" / "presets").mkdir()
    (home / "extension" / "presets" / "Mine.json").write_text("{}")
    save_take(replace(performance(), info={"source": "Take.mkv"}), earlier / "Take.facetake")
    (earlier / "Take.mkv").write_bytes(b"video")
    save(project / "shot.blend")
    line = takes_store.add(bpy.context.scene, earlier / "Take.facetake")
    save(project / "shot.blend")
    other = home / "Documents" / "Facemime" / "takes" / "Take.facetake"
    save_take(performance(), other)
    before = other.read_bytes()
    storage.adopt_earlier_files()
    shutil.rmtree(home / "extension")
    assert presets.names() == ["Mine"] and other.read_bytes() == before
    assert len(takes_store.read(line)) == 60, "in the open file"
    bpy.ops.wm.open_mainfile(filepath=str(project / "shot.blend"))
    (line,) = bpy.context.scene.facemime_takes.items
    assert len(takes_store.read(line)) == 60
    assert takes_store.video_of(bpy.context.scene, line).read_bytes() == b"video"
    storage.adopt_earlier_files()
    assert len(takes_store.read(line)) == 60


@pytest.mark.parametrize("text", ["", "[]", '{"format": "facemime-moved-files", "names": {"/a": "../../b"}}'])
def test_a_damaged_list_of_moved_files_is_ignored(home, text):
    folder = home / "Documents" / "Facemime" / "takes"
    folder.mkdir(parents=True)
    (folder / storage.MOVED).write_text(text)
    assert storage.located("/a") == Path("/a")


def test_takes_of_a_file_that_was_saved_on_windows_are_found(project):
    save(project / "shot.blend")
    line = keep("Anna")
    assert line.path == "//takes/Anna.facetake"
    line.path = "//takes\\Anna.facetake"
    assert len(takes_store.read(line)) == 60
    save(project / "shot.blend")
    assert line.path == "//takes/Anna.facetake"


def painted(path: Path) -> bpy.types.Image:
    """An image from a file, with a pixel that was painted and not saved."""
    cv2.imwrite(str(path), np.zeros((8, 8, 3), np.uint8))
    image = bpy.data.images.load(str(path))
    image.use_fake_user = True
    image.pixels[0] = 1.0
    image.update()
    return image


def test_what_was_painted_on_a_texture_and_not_saved_is_kept_when_the_file_is_saved(home, project):
    image = painted(project / "skin.png")
    keep()
    for path in (project / "shot.blend", project / "shot.blend", project / "other" / "shot.blend"):
        path.parent.mkdir(exist_ok=True)
        save(path)
        assert image.is_dirty and image.pixels[0] == 1.0


def test_paths_of_textures_and_videos_are_still_right_after_the_file_was_saved_elsewhere(home, project):
    cv2.imwrite(str(project / "skin.png"), np.zeros((8, 8, 3), np.uint8))
    image = bpy.data.images.load(str(project / "skin.png"))
    image.use_fake_user = True
    save(project / "shot.blend")
    image.filepath = "//skin.png"
    keep()
    (project / "shots" / "10").mkdir(parents=True)
    for _ in range(2):
        save(project / "shots" / "10" / "shot.blend")
        assert slashes(image.filepath) == "//../../skin.png"
        assert Path(bpy.path.abspath(bpy.context.scene.facemime_takes.items[0].path)).exists()


def test_the_video_of_a_take_is_found_after_the_folder_of_the_project_was_moved(home, project):
    media = project / "media"
    media.mkdir()
    (media / "clip.mp4").write_bytes(b"video")
    takes_store.keep(bpy.context.scene, performance(), "Take", str(media / "clip.mp4"))
    save(project / "shot.blend")
    moved = project.rename(project.parent / "elsewhere")
    bpy.ops.wm.open_mainfile(filepath=str(moved / "shot.blend"))
    scene = bpy.context.scene
    (line,) = scene.facemime_takes.items
    assert line.video == "//media/clip.mp4" and takes_store.video_of(scene, line) == moved / "media" / "clip.mp4"
    save(moved / "scenes.blend")
    assert takes_store.video_of(scene, line) == moved / "media" / "clip.mp4"
