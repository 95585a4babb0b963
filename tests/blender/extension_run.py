"""Runs in a bare Blender with a temporary profile: install the zip, use it, disable, enable and remove it.

Usage: python extension_run.py ARCHIVE CLIP. Prints one line of JSON; the exit status is 0 only if everything succeeded.
"""

import importlib
import json
import os
import socket
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

ARCHIVE, CLIP = sys.argv[1:3]
MODULE = "bl_ext.user_default.facemime"


def main() -> dict:
    """Install, use and remove the extension; return what was measured."""
    import bpy  # isort: skip - it makes addon_utils known
    import addon_utils

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    earlier = repository(bpy).parent / ".user" / "user_default" / "facemime" / "takes" / "earlier.facetake"
    earlier.parent.mkdir(parents=True)
    earlier.touch()
    bpy.ops.extensions.package_install_files(
        filepath=ARCHIVE, repo="user_default", enable_on_install=True, overwrite=True
    )
    assert addon_utils.check(MODULE) == (True, True), "the extension is not enabled"
    import cv2

    assert Path(cv2.__file__).is_relative_to(os.environ["BLENDER_USER_RESOURCES"]), cv2.__file__
    assert "scipy" not in sys.modules, "scipy slows down enabling"
    assert bpy.ops.facemime.add_head(units=True) == {"FINISHED"}
    head = bpy.context.active_object
    assert bpy.ops.facemime.puppet_video(filepath=CLIP) == {"FINISHED"}
    keys = head.data.shape_keys.key_blocks
    baked = [key.name for key in keys if key.name.startswith("Facemime ")]
    moved = 0.0
    for frame in range(bpy.context.scene.frame_start, bpy.context.scene.frame_end + 1, 5):
        bpy.context.scene.frame_set(frame)
        moved = max(moved, *(abs(keys[name].value) for name in baked))
    viewer = importlib.import_module(f"{MODULE}.core.viewer.server")
    settings = importlib.import_module(f"{MODULE}.core.viewer.viewer_settings").ViewerSettings(port=0)
    with viewer.ViewerServer(settings, []) as server, urllib.request.urlopen(server.address) as answer:
        page = answer.read().decode()
    measured = {
        "page": page,
        "received": send_across_networks(bpy),
        "blender": bpy.app.version_string,
        "python": sys.version.split()[0],
        "vertices": len(head.data.vertices),
        "units": len(keys) - 1 - len(baked),
        "baked": len(baked),
        "largest": moved,
        "frames": bpy.context.scene.frame_end,
    }
    measured |= bake_every_way(bpy, head)
    head.vertex_groups.clear()
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"} and bpy.ops.facemime.check_head() == {"FINISHED"}
    import scipy

    assert Path(scipy.__file__).is_relative_to(os.environ["BLENDER_USER_RESOURCES"]), scipy.__file__
    own = keep_files(bpy)
    for _ in range(2):
        addon_utils.disable(MODULE)
        assert not hasattr(bpy.types.Scene, "facemime")
        addon_utils.enable(MODULE)
        assert bpy.context.scene.facemime is not None
    bpy.ops.preferences.addon_disable(module=MODULE)
    bpy.ops.extensions.package_uninstall(repo_directory=str(repository(bpy)), pkg_id="facemime")
    assert not (repository(bpy) / "facemime").exists(), "the extension was not removed"
    assert all(path.is_file() for path in own), "a take or preset was removed with the extension"
    assert (own[0].parent / "earlier.facetake").is_file() and not earlier.exists()
    return measured


def send_across_networks(bpy) -> int:
    """Send a face to a paired receiver over TLS with what the extension contains; return the number of frames."""
    streams, output = f"{MODULE}.core.streams", bpy.context.scene.facemime.output
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        output.port = probe.getsockname()[1]
    output.enabled, output.across, output.listen = True, True, "127.0.0.1"
    line = importlib.import_module(f"{MODULE}.settings.properties").pairing_line(output)
    import Cryptodome

    assert Path(Cryptodome.__file__).is_relative_to(os.environ["BLENDER_USER_RESOURCES"]), Cryptodome.__file__
    pairing = importlib.import_module(f"{streams}.transport.addresses").parse_pairing(line)
    settings = importlib.import_module(f"{streams}.stream_settings").StreamSettings(pairing=pairing)
    source = importlib.import_module(f"{streams}.source").StreamSource(settings, every=True)
    face = importlib.import_module(f"{MODULE}.core.takes.measured").coefficient_face()
    result = face.result([0.5] * 52, [0.0] * 3, None)
    sender = importlib.import_module(f"{MODULE}.settings.values").open_sender(bpy.context.scene.facemime)
    received, end = 0, time.monotonic() + 60.0
    while received < 3 and time.monotonic() < end:
        sender.send(time.monotonic(), result, None)
        received += source.read(0.05) is not None
    source.close()
    sender.close()
    output.enabled = False
    return received


def keep_files(bpy) -> list[Path]:
    """Keep a take of the clip and a preset before the .blend file is saved; return their paths."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert bpy.ops.facemime.add_head() == bpy.ops.facemime.puppet_video(filepath=CLIP) == {"FINISHED"}
    assert bpy.ops.facemime.save_preset(name="Mine") == {"FINISHED"}
    presets = importlib.import_module(f"{MODULE}.settings.user_presets")
    return [Path(bpy.context.scene.facemime_takes.items[0].path), presets.path_of("Mine")]


def bake_every_way(bpy, head) -> dict:
    """Bake the clip to shape keys and to a cache with the installed modules; return the errors of the playback."""
    puppet = importlib.import_module(f"{MODULE}.blender.animation.puppet")
    timeline = importlib.import_module(f"{MODULE}.blender.timeline")
    pipeline = importlib.import_module(f"{MODULE}.core.takes.from_video")
    tracker = importlib.import_module(f"{MODULE}.core.tracking.tracker")
    take = pipeline.track_video(Path(CLIP), tracker.FaceTracker.load()).part(slice(0, 50))
    settings = importlib.import_module(f"{MODULE}.core.bake.bake_settings")
    scene, worst = bpy.context.scene, {}
    scene.render.fps, scene.render.fps_base = 25, 1.0
    rig = puppet.read_rig(head)
    unit = rig.eye_distance
    with tempfile.TemporaryDirectory() as folder:
        for keys in (kind for kind in settings.KEYS if kind != "controls"):  # which a rig has to have
            options = settings.BakeSettings(keys=keys, clean=0.002, nla=keys == "named", path=Path(folder) / "a.pc2")
            report = puppet.puppet_head(scene, head, take, puppet.PuppetSettings(bake=options))
            worst[keys] = 0.0
            for row in range(len(report.motion.times)):
                frame = float(timeline.frames_of(scene, report.motion.times[row]))
                scene.frame_set(int(frame // 1), subframe=frame % 1.0)
                mesh = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
                shown = [(v.co.x, -v.co.z, v.co.y) for v in mesh.vertices]
                away = abs(shown - rig.vertices - report.motion.vertices[row][: len(rig.vertices)]).max() / unit
                worst[keys] = max(worst[keys], float(away))
            assert worst[keys] <= report.worst_error + 1e-4, (keys, worst[keys], report.worst_error)
        head.modifiers.clear()
        importlib.import_module(f"{MODULE}.core.takes.file").save_take(take, Path(folder) / "take.facetake")
        list_and_show(bpy, head, Path(folder))
    return {"worst": worst}


def list_and_show(bpy, head, folder: Path) -> None:
    """Import a take, pack it, save and open the file, show it, and bake it with the detected key mapping."""
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "file.blend"), copy=True)
    assert bpy.ops.facemime.import_take(filepath=str(folder / "take.facetake")) == {"FINISHED"}
    assert bpy.ops.facemime.pack_take() == {"FINISHED"} and bpy.ops.facemime.show_take() == {"FINISHED"}
    bpy.context.scene.frame_set(30)
    assert "Facemime Live" in head.data.shape_keys.key_blocks
    assert bpy.ops.facemime.show_take() == {"FINISHED"}
    assert bpy.ops.facemime.detect_key_map() == {"FINISHED"}
    takes = bpy.context.scene.facemime_takes
    takes.bake.keys, takes.bake.nla = "mapped", True
    assert len(takes.bake.rows) == 52 and bpy.ops.facemime.bake_take() == {"FINISHED"}
    assert [track.name for track in head.data.shape_keys.animation_data.nla_tracks] == ["Facemime"]


def repository(bpy) -> Path:
    """Return the folder of the repository for extensions installed from disk."""
    repos = bpy.context.preferences.extensions.repos
    return Path(next(repo for repo in repos if repo.module == "user_default").directory)


if __name__ == "__main__":
    # Windows does not delete libraries that are loaded.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        os.environ["BLENDER_USER_RESOURCES"] = os.environ["HOME"] = os.environ["USERPROFILE"] = profile
        print(json.dumps(main()), flush=True)
