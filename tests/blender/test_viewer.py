"""The viewer of a running puppet: served while it runs, according to the settings, with the look of the head."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import bpy
import cv2
import numpy as np
import pytest
from websockets.sync.client import connect

from facemime.blender.animation.appearance import read_appearance
from facemime.blender.heads.new_heads import add_head
from facemime.blender.preview_scene import setup_preview
from facemime.cli.main import main
from facemime.core.drive.driver import HeadDriver
from facemime.core.errors import SourceError
from facemime.core.heads.appearance import built_in_appearance
from facemime.core.heads.rig import built_in_head
from facemime.core.streams.transport.addresses import EVERYWHERE
from facemime.core.takes.file import save_take
from facemime.core.takes.measured import coefficient_face
from facemime.core.viewer.model import viewer_model
from facemime.core.viewer.page import BUILT, PAGE
from facemime.operators.puppet import running
from facemime.settings.values import viewer_settings
from tests.helpers.clocks import PATIENCE
from tests.helpers.commands import START, needs_posix
from tests.helpers.live_ticks import some_frames, start, tick, ticks_until
from tests.helpers.takes import performance

pytestmark = [
    pytest.mark.usefixtures("nothing_left_over"),
    pytest.mark.skipif(not (PAGE / BUILT).is_file(), reason="the page is not built: make viewer"),
]


@pytest.fixture
def viewer():
    """The settings of the viewer, turned on, on any port."""
    settings = bpy.context.scene.facemime.viewer
    settings.enabled, settings.port = True, 0
    return settings


def images_of(head) -> list[int]:
    """Length of the images of a head's surfaces and parts."""
    patches = [*head.patches, *(patch for part in head.parts for patch in part.patches)]
    return [len(patch.surface.image) for patch in patches]


def test_a_browser_gets_the_running_puppet(viewer):
    add_head(bpy.context)
    start()
    some_frames()
    server = running().displays.viewer
    with connect(server.address.replace("http", "ws", 1) + "stream", open_timeout=PATIENCE) as page:
        ticks_until(lambda: server.viewers == 1)
        scene = json.loads(page.recv(timeout=PATIENCE))
        while not scene["images"]:
            scene = json.loads(page.recv(timeout=PATIENCE))
        assert scene["images"] == [5]
        first = page.recv(timeout=PATIENCE)
        assert len(first) == 508
        some_frames()
        assert page.recv(timeout=PATIENCE) != first
        assert bpy.ops.facemime.copy_viewer_address() == {"FINISHED"}
        bpy.ops.facemime.stop_puppet()


def test_the_viewer_starts_and_stops_during_a_puppet_at_the_same_address(viewer):
    add_head(bpy.context)
    viewer.enabled = False
    start()
    tick()
    assert running().displays.viewer is None
    assert not bpy.ops.facemime.open_viewer.poll()
    viewer.enabled = True
    ticks_until(lambda: running().displays.viewer is not None)
    secret = running().displays.viewer.address.split("/")[3]
    viewer.enabled = False
    ticks_until(lambda: running().displays.viewer is None)
    viewer.enabled = True
    ticks_until(lambda: running().displays.viewer is not None)
    assert running().displays.viewer.address.split("/")[3] == secret
    assert bpy.ops.facemime.open_viewer.poll()
    bpy.ops.facemime.stop_puppet()


def test_other_computers_need_online_access(viewer):
    system = bpy.context.preferences.system
    before, system.use_online_access = system.use_online_access, False
    try:
        viewer.host = EVERYWHERE
        with pytest.raises(SourceError, match="online access is turned off"):
            viewer_settings(viewer, "token")
        viewer.host = "localhost"
        assert viewer_settings(viewer, "token").is_local
    finally:
        system.use_online_access = before


def test_an_error_of_the_viewer_during_a_puppet_turns_only_the_viewer_off(viewer):
    add_head(bpy.context)
    start()
    tick()
    viewer.certificate = "/none.pem"
    ticks_until(lambda: not viewer.enabled)
    assert running() is not None and running().displays.viewer is None
    bpy.ops.facemime.stop_puppet()


def test_the_built_in_head_looks_in_the_browser_as_it_does_in_blender():
    head = add_head(bpy.context)
    ours, built_in = read_appearance(head), built_in_appearance(head.name)
    driver = HeadDriver(built_in_head(lashes=True), coefficient_face().neutral)
    assert sorted(images_of(ours)) == sorted(images_of(built_in))
    found = {(part.follows, len(part.vertices)): part for part in ours.parts if part.out is None}
    for part in (part for part in built_in.parts if part.out is None):
        one = found.pop((part.follows, len(part.vertices)))
        np.testing.assert_allclose(one.vertices, part.vertices, atol=1e-6)
        np.testing.assert_allclose(one.pivot, part.pivot, atol=1e-6)
    assert not found
    (tongue,) = (part for part in ours.parts if part.out is not None)
    expected = next(part for part in built_in.parts if part.out is not None)
    np.testing.assert_allclose(tongue.out, expected.out, atol=1e-4)
    assert abs(len(viewer_model(driver, ours).data) - len(viewer_model(driver, built_in).data)) < 1000


def test_a_plain_material_has_its_colour():
    head = add_head(bpy.context)
    material = bpy.data.materials.new("Green")
    if material.node_tree is None:
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (0.1, 0.6, 0.2, 1.0)
    head.data.materials[0] = material
    surface = read_appearance(head).patches[0].surface
    np.testing.assert_allclose(surface.colour, (0.1, 0.6, 0.2), atol=1e-6)
    assert surface.image == b""


@pytest.fixture
def painted(tmp_path) -> tuple[bpy.types.Object, bpy.types.Material, dict[str, Path]]:
    """A head whose material has an image for its colour and then one for its roughness, as imports have."""
    head, files = add_head(bpy.context), {}
    material = bpy.data.materials.new("Painted")
    if material.node_tree is None:
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, socket, value in (("colour", "Base Color", 200), ("rough", "Roughness", 20)):
        files[name] = tmp_path / f"{name}.webp"
        cv2.imwrite(str(files[name]), np.full((8, 8, 4), value, np.uint8))
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.load(str(files[name]))
        material.node_tree.links.new(node.outputs["Color"], shader.inputs[socket])
        material.node_tree.nodes.active = node
    head.data.materials[0] = material
    return head, material, files


def test_an_image_with_alpha_is_shown_with_it(painted):
    head, material, files = painted
    surface = read_appearance(head).patches[0].surface
    assert surface.image == files["colour"].read_bytes() and not surface.alpha
    links = {link.to_socket.name: link.from_node for link in material.node_tree.links}
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(links["Base Color"].outputs["Alpha"], shader.inputs["Alpha"])
    assert read_appearance(head).patches[0].surface.alpha


def test_a_preview_shows_the_image_of_the_colour_and_not_the_last_one(painted):
    head, material, _ = painted
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    colour = shader.inputs["Base Color"].links[0].from_node
    colour.image.alpha_mode = "CHANNEL_PACKED"
    material.node_tree.links.new(colour.outputs["Alpha"], shader.inputs["Alpha"])
    setup_preview(bpy.context.scene, head, (64, 64))
    assert colour.image.alpha_mode == "STRAIGHT", "Workbench ignores the alpha of packed channels"
    assert material.node_tree.nodes.active.image.filepath.endswith("colour.webp")


@needs_posix
@pytest.mark.thorough
def test_the_command_serves_a_character_of_a_file(tmp_path):
    save_take(performance(), tmp_path / "take.facetake")
    path = tmp_path / "character.blend"
    subprocess.run(
        [sys.executable, "-m", "tests.helpers.characters", str(path)],
        cwd=PAGE.parents[1],
        check=True,
        capture_output=True,
    )
    line = [
        *START,
        "serve",
        "--video",
        str(tmp_path / "take.facetake"),
        "--loop",
        "--listen",
        ":0",
        "--head",
        str(path),
    ]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        address = next(row.strip() for row in server.stdout if row.startswith("http"))
        with connect(address.replace("http", "ws", 1) + "stream", open_timeout=PATIENCE) as page:
            while not (scene := json.loads(page.recv(timeout=PATIENCE)))["images"]:
                pass
            frames = {page.recv(timeout=PATIENCE)[16:] for _ in range(20)}
            with urlopen(f"{address}{scene['path']}/0/model", timeout=PATIENCE) as answer:
                model = answer.read()
        server.send_signal(signal.SIGINT)
        said = server.stderr.read()
    assert server.returncode == 0 and "Bound" in said
    header = json.loads(model[8 : 8 + int.from_bytes(model[4:8], "little")])
    assert len(frames) > 5 and len(scene["images"]) == 1 and scene["images"] != [4], "another head moves"
    assert header["surfaces"] and len(model) > 100_000


def test_a_head_is_only_sent_as_vertices(capsys):
    line = ["send", "--video", "a.mp4", "--to", "127.0.0.1", "--head", "a.blend"]
    assert main(line) == 1 and "--protocol vertices" in capsys.readouterr().err
