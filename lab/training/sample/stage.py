"""The stage: Blender's scene in which the performer is filmed as if by a webcam."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import cv2
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

from facemime.blender.frames import to_blender
from facemime.blender.rendering import quiet

from .actor import Actor

SIZE = (640, 480)
RENDER_SHARE = 0.75
"""Share of the size at which images are rendered, and then enlarged, as a webcam's image is no sharper."""

_LENS, _DISTANCE = 47.0, 0.62
_AIM = np.array([0.0, 0.022])


def project(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (..., 2) in the clip of points (..., 3) in the head frame."""
    focal = SIZE[0] * _LENS / 36.0
    middle = (np.array(SIZE) - 1.0) / 2.0
    depth = points[..., 2:] + _DISTANCE
    return np.asarray(middle + focal * (points[..., :2] - _AIM) / depth)


class Stage:
    """The scene, and the meshes that change from frame to frame."""

    def __init__(self, actor: Actor, skin: Path, samples: int) -> None:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        self.actor, self.scene = actor, bpy.context.scene
        self.folder = tempfile.TemporaryDirectory()
        self.skins = {name: self._mesh(name, part.faces, part.uv) for name, part in actor.skins.items()}
        self.parts = [self._mesh(part.name, part.faces, part.uv) for part in actor.parts]
        self._materials(skin)
        self._camera()
        self._lights()
        self._render_settings(samples)
        self.background = _room()

    def film(
        self, moments: Iterator[tuple[NDArray[np.float64], list[NDArray[np.float64]]]]
    ) -> Iterator[NDArray[np.uint8]]:
        """Yield a BGR image of `SIZE` for each pair of base and part vertices."""
        path = str(Path(self.folder.name) / "frame.png")
        self.scene.render.filepath = path
        for points, parts in moments:
            for mesh in self.skins.values():
                _move(mesh, points[mesh["rows"]])
            for mesh, vertices in zip(self.parts, parts, strict=True):
                _move(mesh, vertices[mesh["rows"]])
            with quiet():
                bpy.ops.render.render(write_still=True)
            yield self._developed(cv2.imread(path, cv2.IMREAD_UNCHANGED))

    def _developed(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Put the image in front of the room, and enlarge it as a webcam would."""
        premultiplied = picture.astype(np.float32) / 255.0
        premultiplied[..., :3] *= premultiplied[..., 3:]
        premultiplied = cv2.GaussianBlur(premultiplied, (0, 0), 0.45)
        large = cv2.resize(premultiplied, SIZE, interpolation=cv2.INTER_CUBIC)
        image = large[..., :3] + self.background * np.clip(1.0 - large[..., 3:], 0.0, 1.0)
        return np.asarray((np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8))

    def _mesh(self, name: str, faces: NDArray[np.int64], uv: NDArray[np.float64]) -> bpy.types.Mesh:
        rows, numbered = np.unique(faces[faces >= 0], return_inverse=True)
        corner = faces >= 0
        counts = corner.sum(axis=1)
        mesh = bpy.data.meshes.new(name)
        mesh.vertices.add(len(rows))
        mesh.loops.add(len(numbered))
        mesh.polygons.add(len(faces))
        mesh.loops.foreach_set("vertex_index", numbered.astype(np.int32).ravel())
        mesh.polygons.foreach_set("loop_start", (np.cumsum(counts) - counts).astype(np.int32))
        mesh.polygons.foreach_set("loop_total", counts.astype(np.int32))
        mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
        layer = mesh.uv_layers.new(name="UVMap")
        layer.data.foreach_set("uv", uv[corner].astype(np.float32).ravel())
        mesh["rows"] = rows.astype(int).tolist()
        mesh.update(calc_edges=True)
        self.scene.collection.objects.link(bpy.data.objects.new(name, mesh))
        return mesh

    def _materials(self, skin: Path) -> None:
        assets = Path(__file__).parents[3] / "assets" / "head"
        head = Path(self.folder.name) / "head.png"
        cv2.imwrite(str(head), self.actor.texture)
        looks = {
            "head": (head, 0.50),
            "neck": (skin, 0.55),
            "flesh": ((0.20, 0.05, 0.05), 0.45),
            "shirt": ((0.035, 0.060, 0.095), 0.95),
            "eye_left": (assets / "eye.jpg", 0.08),
            "eye_right": (assets / "eye.jpg", 0.08),
            "teeth_upper": (assets / "teeth.jpg", 0.25),
            "teeth_lower": (assets / "teeth.jpg", 0.25),
            "tongue": (assets / "tongue.jpg", 0.40),
        }
        for mesh in [*self.skins.values(), *self.parts]:
            mesh.materials.append(_material(mesh.name, *looks[mesh.name]))

    def _camera(self) -> None:
        data = bpy.data.cameras.new("Webcam")
        data.lens, data.sensor_width, data.sensor_fit = _LENS, 36.0, "HORIZONTAL"
        camera = bpy.data.objects.new("Webcam", data)
        camera.location = to_blender(np.array([*_AIM, -_DISTANCE]))
        camera.rotation_euler = (np.pi / 2.0, 0.0, 0.0)
        self.scene.collection.objects.link(camera)
        self.scene.camera = camera

    def _lights(self) -> None:
        """A window to the left, the screen in front, a lamp behind."""
        for place, power, size, colour in (
            ((-0.75, -0.70, 0.45), 12.0, 0.90, (1.0, 0.97, 0.93)),
            ((0.20, -0.80, -0.05), 2.6, 0.50, (0.85, 0.92, 1.0)),
            ((0.80, -0.30, 0.35), 2.6, 0.70, (1.0, 0.90, 0.80)),
            ((0.30, 0.70, 0.60), 3.0, 0.50, (1.0, 0.92, 0.82)),
        ):
            data = bpy.data.lights.new("Light", "AREA")
            data.energy, data.size, data.color = power, size, colour
            light = bpy.data.objects.new("Light", data)
            light.location = place
            light.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
            self.scene.collection.objects.link(light)
        world = bpy.data.worlds.new("Room")
        world.use_nodes = True
        background = world.node_tree.nodes["Background"]
        background.inputs["Color"].default_value = (0.55, 0.52, 0.48, 1.0)
        background.inputs["Strength"].default_value = 0.35
        self.scene.world = world

    def _render_settings(self, samples: int) -> None:
        render = self.scene.render
        render.engine = "CYCLES"
        render.resolution_x, render.resolution_y = (round(side * RENDER_SHARE) for side in SIZE)
        render.film_transparent = True
        render.image_settings.file_format = "PNG"
        render.image_settings.color_mode = "RGBA"
        render.image_settings.compression = 0
        render.use_persistent_data = True
        self.scene.view_settings.view_transform = "Standard"
        cycles = self.scene.cycles
        cycles.samples = samples
        cycles.seed = 1
        cycles.use_denoising = True
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 2, 1, 1
        cycles.caustics_reflective = cycles.caustics_refractive = False


def _move(mesh: bpy.types.Mesh, vertices: NDArray[np.float64]) -> None:
    mesh.vertices.foreach_set("co", to_blender(vertices).astype(np.float32).ravel())
    mesh.update()


def _material(name: str, look: Path | tuple[float, float, float], roughness: float) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = roughness
    if isinstance(look, Path):
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(str(look))
        tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    else:
        shader.inputs["Base Color"].default_value = (*look, 1.0)
    return material


def _room() -> NDArray[np.float32]:
    """A plain room, out of focus: a lit wall, a door frame, a shelf."""
    width, height = SIZE
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    wall = 0.62 - 0.16 * (x / width) - 0.06 * (y / height)
    room = wall[..., None] * np.float32([0.88, 0.96, 1.0])
    room[:, int(0.82 * width) : int(0.97 * width)] *= np.float32([0.66, 0.70, 0.74])
    room[:, int(0.965 * width) :] *= 0.80
    room[int(0.30 * height) : int(0.325 * height), : int(0.24 * width)] *= 0.62
    for left, wide, tone in (
        (0.02, 0.025, (0.45, 0.42, 0.60)),
        (0.05, 0.03, (0.62, 0.52, 0.40)),
        (0.085, 0.02, (0.4, 0.55, 0.5)),
    ):
        books = slice(int(0.16 * height), int(0.30 * height)), slice(int(left * width), int((left + wide) * width))
        room[books] = room[books] * 0.35 + np.float32(tone) * 0.5
    return np.asarray(cv2.GaussianBlur(room, (0, 0), 9.0), np.float32)
