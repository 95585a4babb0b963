"""Runs in a bare Blender with a temporary profile: install from a repository, then update to its next version.

Usage: python index_run.py REPOSITORY NEXT, folders with an index of an earlier and of this version. Prints one line of
JSON; the exit status is 0 only if everything succeeded.
"""

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

REPOSITORY, NEXT = map(Path, sys.argv[1:3])
MODULE = "bl_ext.facemime_org.facemime"
FILES = Path(__file__).resolve().parents[1] / "data" / "before_floors"


def main() -> dict:
    """Install, update and remove the extension; return its versions, and what is left of the user's files."""
    import bpy  # isort: skip - it makes addon_utils known
    import addon_utils

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.preferences.system.use_online_access = True  # which file:// needs, too
    repositories = bpy.context.preferences.extensions.repos
    added = repositories.new(name="Facemime", module="facemime_org", remote_url=(REPOSITORY / "index.json").as_uri())
    index = repositories.values().index(added)
    bpy.ops.extensions.repo_sync(repo_index=index)
    bpy.ops.extensions.package_install(repo_index=index, pkg_id="facemime", enable_on_install=True)
    assert addon_utils.check(MODULE) == (True, True), "the extension is not enabled"
    versions = [version_of(added)]
    preset = Path(bpy.utils.user_resource("SCRIPTS", path="presets/facemime", create=True)) / "Mine.json"
    assert bpy.ops.facemime.save_preset(name="Mine") == {"FINISHED"} and preset.exists()
    project = Path(os.environ["BLENDER_USER_RESOURCES"]) / "project"
    project.mkdir()
    shutil.copy(FILES / "take.facetake", project)
    bpy.ops.wm.open_mainfile(filepath=str(FILES / "scene.blend"))
    assert bpy.ops.facemime.import_take(filepath=str(project / "take.facetake")) == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scene.blend"))
    before = content(bpy)
    for path in NEXT.iterdir():
        (REPOSITORY / path.name).unlink(missing_ok=True)
        (REPOSITORY / path.name).symlink_to(path)
    bpy.ops.extensions.repo_sync(repo_index=index)
    bpy.ops.extensions.package_upgrade_all()
    assert addon_utils.check(MODULE) == (True, True), "the extension is not enabled after the update"
    versions.append(version_of(added))
    kept = preset.exists()
    bpy.ops.wm.open_mainfile(filepath=str(project / "scene.blend"))
    scene_kept = content(bpy) == before and bpy.ops.facemime.show_take() == {"FINISHED"}
    bpy.ops.extensions.package_uninstall(repo_index=index, pkg_id="facemime")
    return {"versions": versions, "kept": kept, "scene_kept": scene_kept}


def content(bpy: object) -> tuple:
    """Return the settings of the scene, its takes, and the landmarks of its head."""
    scene = bpy.context.scene
    settings = [
        (name, getattr(scene.facemime, name))
        for name, prop in scene.facemime.bl_rna.properties.items()
        if prop.type in ("FLOAT", "BOOLEAN", "ENUM")
    ]
    heads = [
        sorted((key, list(value)) for key, value in obj.data.items() if "landmark" in key and hasattr(value, "__len__"))
        for obj in scene.objects
        if obj.type == "MESH"
    ]
    takes = [(line.name, line.path) for line in scene.facemime_takes.items]
    assert takes and any(heads), (takes, heads)
    return settings, takes, heads


def version_of(repository: object) -> str:
    """Return the version that is installed."""
    lines = (Path(repository.directory) / "facemime" / "blender_manifest.toml").read_text().splitlines()
    return next(line.split('"')[1] for line in lines if line.startswith("version = "))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as profile:
        os.environ["BLENDER_USER_RESOURCES"] = profile
        print(json.dumps(main()), flush=True)
    os._exit(0)
