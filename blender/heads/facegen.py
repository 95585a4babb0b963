"""FaceGen heads that are imported: the skin with its morphs, its texture, and the parts in files beside it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.errors import ModelError, SourceError
from ...core.files.assets import ASSETS
from ...core.heads.bind import MIN_MARKS
from ...core.heads.facegen import FaceGenMesh, read_egm, read_obj, read_tri
from ...core.heads.part_names import names_inside, parts_in, spaced
from ...core.heads.rig import Part
from ...core.heads.tongues import tongue_lowered, tongue_of
from ..characters import members_of, read_kinds
from ..frames import to_blender
from ..meshes import mesh_of, move_vertices
from ..names import FACEGEN_PROPERTY, UV_MAP
from ..rigs import read_rig
from ..surfaces import colour_node
from ..view_layers import select_alone
from .binding import bind_character, check_object, write_marks
from .materials import mouth_material, plain_material, show_image
from .painted_eyes import replace_eyes

MILLIMETRE = 0.001
_JANE = ASSETS / "facegen" / "Jane.tri"
_MADE_UP = _JANE.with_suffix(".jpg")
TRI, OBJ = ".tri", ".obj"
_READERS = {TRI: read_tri, OBJ: read_obj}
_IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".tga", ".tif", ".tiff")
_UNWANTED = re.compile(r" (?:small|(?:sun )?glass(?:es)?|spectacles?|goggles?|helmet|hat|cap) ")
"""Words in the names of coarser copies of parts, and of what not everybody wears."""
_MARKS: Mapping[str, int] = {
    "exocanthionright": 36,
    "endocanthionright": 39,
    "endocanthionleft": 42,
    "exocanthionleft": 45,
    "nosetip": 30,
    "pronasale": 30,
    "mouthcornerright": 48,
    "mouthcornerleft": 54,
    "cheilionright": 48,
    "cheilionleft": 54,
    "gnathion": 8,
    "menton": 8,
    "chin": 8,
}
"""Labels of a file that are marks of `bind.MARKS`, by name without spaces."""
_SAME = 0.02
"""Difference, as a share of the largest motion, below which two morphs of one name are the same. FaceGen's heads have
some of them twice or three times."""

_SKIN = ((0.69, 0.45, 0.35), 0.5)
_LOOKS: Sequence[tuple[str, tuple[tuple[float, float, float], float]]] = (
    ("mouth", ((0.16, 0.035, 0.03), 0.35)),
    ("teeth", ((0.80, 0.76, 0.66), 0.18)),
    ("tongue", ((0.45, 0.14, 0.13), 0.3)),
    ("hair", ((0.015, 0.010, 0.008), 0.6)),
    ("lash", ((0.01, 0.008, 0.007), 0.6)),
    ("brow", ((0.03, 0.02, 0.015), 0.7)),
    ("eye", ((0.85, 0.83, 0.80), 0.06)),
    ("glass", ((0.02, 0.02, 0.022), 0.2)),
)
"""Linear RGB colour and roughness of parts without a texture, by words of their names."""


def import_facegen(
    context: bpy.types.Context, paths: Sequence[Path], scale: float = MILLIMETRE, *, beside: bool = True
) -> list[bpy.types.Object]:
    """Import FaceGen's `.tri` or `.obj` files, and return the objects; the first, a head if there is one, is active.

    Files that are named after parts become children of the first head. If `beside` is set and no part is among `paths`,
    the parts in the folder of a single head are imported too. Textures and the modes of `.egm` files are found by the
    names of their meshes. `scale` is metres per unit. Raises SourceError if a file is damaged or not FaceGen's, and
    nothing is imported then.
    """
    chosen = list(dict.fromkeys(paths))
    if beside and len(chosen) == 1 and not _is_part(chosen[0]):
        chosen += parts_beside(chosen[0])
    read = [(path, _read(path)) for path in chosen]
    read.sort(key=lambda pair: _is_part(pair[0]))
    objects = [_add(context, path, mesh, modes, scale) for path, (mesh, modes) in read]
    head = objects[0]
    if not _is_part(read[0][0]):
        for (path, _), obj in zip(read[1:], objects[1:], strict=True):
            obj.parent = head if _is_part(path) else None
    select_alone(context, head)
    return objects


def add_facegen(context: bpy.types.Context) -> bpy.types.Object:
    """Add Jane, a head by FaceGen's makers, in a new collection, ready to be driven, and return her skin."""
    if not _JANE.is_file():
        raise ModelError("The head {path} is missing. Reinstall Facemime.", path=_JANE)
    collection = bpy.data.collections.new(_JANE.stem)
    context.collection.children.link(collection)
    objects = import_facegen(context, [_JANE])
    for obj in objects:
        for other in obj.users_collection:
            other.objects.unlink(obj)
        collection.objects.link(obj)
    head, _ = bind_character(objects[0])
    prepare_facegen(head)
    select_alone(context, head)
    return head


def _image_nodes(obj: bpy.types.Object) -> list[bpy.types.ShaderNodeTexImage]:
    nodes = (colour_node(material) for material in mesh_of(obj).materials if material is not None)
    return [node for node in nodes if node is not None]


def prepare_facegen(head: bpy.types.Object) -> bool:
    """Prepare the mouth of a bound head, and put eyeballs that turn in place of its eyes if they are painted.

    Returns whether they were.
    """
    prepare_mouth(head)
    if not any(finding.step == "open_eyes" for finding in check_object(head)):
        return False
    replace_eyes(head)
    return True


def prepare_mouth(head: bpy.types.Object) -> None:
    """Colour the mouth of a bound FaceGen head by its parts if it has no texture, and open Jane's, wherever her file
    lies. Other heads stay as they are.
    """
    if FACEGEN_PROPERTY not in head:
        return
    _colour_mouth(head)
    if _is_jane(head):
        _open_up_mouth(head)


def _is_jane(head: bpy.types.Object) -> bool:
    """Return whether a head shows Jane's texture. Her tongue fills her mouth, whose wall is as bright."""
    images = [node.image for node in _image_nodes(head) if node.image is not None]
    return any(_is_copy(Path(bpy.path.abspath(image.filepath)), _MADE_UP) for image in images)


def _is_copy(path: Path, of: Path) -> bool:
    """Return whether a file equals another one."""
    try:
        return path == of or (path.stat().st_size == of.stat().st_size and path.read_bytes() == of.read_bytes())
    except OSError:  # an image that is packed, or gone
        return False


def _colour_mouth(head: bpy.types.Object) -> None:
    """Colour the teeth and the tongue of a mouth that is one mesh without a texture, and so dark red all over."""
    every_tongue = tongue_of(read_rig(head))
    for member in members_of(head)[1:]:
        mesh = mesh_of(member.obj)
        kinds, tongue = read_kinds(mesh), every_tongue[member.part]
        (name, *others) = [material.name if material else "" for material in mesh.materials] or [""]
        if others or not names_inside(name) or mesh.materials[0] is None or colour_node(mesh.materials[0]) is not None:
            continue
        looks = dict(_LOOKS)
        mesh.materials.append(plain_material(f"{name} Teeth", *looks["teeth"]))
        mesh.materials.append(plain_material(f"{name} Tongue", *looks["tongue"]))
        teeth = np.isin(kinds, (Part.TEETH_UPPER, Part.TEETH_LOWER))
        for polygon in mesh.polygons:
            first = polygon.vertices[0]
            polygon.material_index = 2 if tongue[first] else int(teeth[first])


def _open_up_mouth(head: bpy.types.Object) -> None:
    """Lay the tongue of a head on the floor of its mouth, and make the wall dark."""
    inside = [mesh_of(member.obj) for member in members_of(head)[1:]]
    if any(mouth_material() in mesh.materials[:] for mesh in inside):
        return  # it was opened before
    rig = read_rig(head)
    tongue = tongue_of(rig)
    down = np.zeros((len(rig.all_vertices), 3))
    if tongue.any():
        down[tongue] = tongue_lowered(rig, tongue)
    for member in members_of(head)[1:]:
        mesh = mesh_of(member.obj)
        move_vertices(mesh, member.local_offsets(down))
        wall = read_kinds(mesh) == Part.ON_SKIN
        if not wall.any():
            continue
        mesh.materials.append(mouth_material())
        for polygon in mesh.polygons:
            if wall[polygon.vertices[0]]:
                polygon.material_index = len(mesh.materials) - 1


def parts_beside(path: Path) -> list[Path]:
    """Return the `.tri` files with parts of a head in its folder, without coarser copies, glasses and hats.

    A file of the whole mouth replaces those of its teeth, tongue and wall.
    """
    try:
        others = [file for file in sorted(path.parent.iterdir()) if file.suffix.lower() == TRI and file != path]
    except OSError:  # a folder that can be entered but not listed
        return []
    parts = [file for file in others if _is_part(file) and not _UNWANTED.search(spaced(file.stem))]
    whole = [file for file in parts if names_inside(file.stem) and not parts_in(file.stem)]
    within = {Part.TEETH_UPPER, Part.TEETH_LOWER}
    return [file for file in parts if not whole or file in whole or not within & set(parts_in(file.stem))]


def _is_part(path: Path) -> bool:
    """Return whether a file is named after a part of a head, such as `teethUpper` or `sock`."""
    return bool(parts_in(path.stem)) or names_inside(path.stem) or " sock " in spaced(path.stem)


def _read(path: Path) -> tuple[FaceGenMesh, tuple[tuple[str, NDArray[np.float32]], ...]]:
    """Read a mesh, and the modes of the `.egm` beside it."""
    if path.suffix.lower() not in _READERS:
        raise SourceError("{path} is not a FaceGen head. Choose a .tri or .obj file.", path=path)
    mesh = _READERS[path.suffix.lower()](path)
    egm = _beside(path, (".egm",))
    return mesh, () if egm is None else read_egm(egm, mesh)


def _beside(path: Path, suffixes: Iterable[str]) -> Path | None:
    """Return the file of the same name with the first of these endings, in lower or upper case, or None."""
    wanted = [path.with_suffix(ending) for suffix in suffixes for ending in (suffix, suffix.upper())]
    return next((file for file in wanted if file.is_file()), None)


def _add(
    context: bpy.types.Context,
    path: Path,
    head: FaceGenMesh,
    modes: tuple[tuple[str, NDArray[np.float32]], ...],
    scale: float,
) -> bpy.types.Object:
    name = "Mouth Sock" if spaced(path.stem).strip() == "sock" else path.stem
    mesh = bpy.data.meshes.new(name)
    faces = [[int(vertex) for vertex in face if vertex >= 0] for face in head.faces]
    mesh.from_pydata((to_blender(head.vertices) * scale).tolist(), [], faces)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
    if head.uv is not None:
        layer = mesh.uv_layers.new(name=UV_MAP)
        layer.data.foreach_set("uv", np.ascontiguousarray(head.uv[head.faces >= 0]).reshape(-1))
    mesh.materials.append(_material(path, textured=head.uv is not None))
    mesh.update()
    obj = bpy.data.objects.new(name, mesh)
    obj[FACEGEN_PROPERTY] = True
    context.collection.objects.link(obj)
    _add_keys(obj, head.vertices, (*_distinct(head.morphs), *modes), scale)
    known = {_MARKS[key]: vertex for key, vertex in _labels(head).items() if key in _MARKS}
    if len(known) >= MIN_MARKS:
        write_marks(mesh_of(obj), known)
    return obj


def _labels(head: FaceGenMesh) -> dict[str, int]:
    return {spaced(name).replace(" ", ""): vertex for name, vertex in head.labels.items()}


def _material(path: Path, *, textured: bool) -> bpy.types.Material:
    """Create the material of a mesh: its texture beside it, or the usual colour of such a part."""
    words = spaced(path.stem)
    look = next((look for word, look in _LOOKS if word in words), _SKIN)
    material = plain_material(path.stem, *look)
    file = _texture(path) if textured else None
    if file is not None:
        image = bpy.data.images.load(str(file), check_existing=True)
        if file.parent == _JANE.parent and image.packed_file is None:
            image.pack()  # so that a saved file does not need the extension
        show_image(material, image)
    return material


def _texture(path: Path) -> Path | None:
    """Return the texture beside the file of a mesh, or ours for a copy of a file of Jane's."""
    ours = _JANE.with_name(path.name)
    return _beside(path, _IMAGES) or (_beside(ours, _IMAGES) if _is_copy(path, ours) else None)


def _distinct(morphs: Sequence[tuple[str, NDArray[np.float32]]]) -> list[tuple[str, NDArray[np.float32]]]:
    """Leave out morphs that repeat one of the same name."""
    kept: list[tuple[str, NDArray[np.float32]]] = []
    for name, offsets in morphs:
        same = (other for known, other in kept if known == name)
        if not any(np.abs(offsets - other).max() <= _SAME * np.abs(other).max() for other in same):
            kept.append((name, offsets))
    return kept


def _add_keys(
    obj: bpy.types.Object,
    rest: NDArray[np.float32],
    morphs: Sequence[tuple[str, NDArray[np.float32]]],
    scale: float,
) -> None:
    if not morphs:
        return
    obj.shape_key_add(name="Basis", from_mix=False)
    for name, offsets in morphs:
        key = obj.shape_key_add(name=name, from_mix=False)
        key.points.foreach_set("co", (to_blender(rest + offsets) * scale).astype(np.float32).reshape(-1))
        key.value = 0.0
