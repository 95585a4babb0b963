"""Built-in heads that are added to a scene, with their parts as children."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.heads.built_in import PART_NAMES, WOMAN_FILE, Head, HeadPart, load_head
from ...core.heads.rig import Part
from ..characters import write_kinds
from ..frames import to_blender
from ..meshes import key_names, mesh_of, read_vertices, write_landmarks, write_regions
from ..names import PART_OBJECTS, PART_PROPERTY, TONGUE_KEY, UV_MAP
from ..view_layers import select_alone
from .attached import attach
from .materials import head_materials, mouth_material

_MOVED = 1e-5
"""Distance in metres by which vertices of a built-in head may differ from where they were."""
_RENDER_LEVELS = 2
"""Levels of subdivision of the skin in renders."""


def add_head(
    context: bpy.types.Context, *, woman: bool = False, units: bool = False, name: str = "Facemime Head"
) -> bpy.types.Object:
    """Add a built-in head at the origin, in a new collection, select it and make it active.

    It faces -Y and stands upright along +Z, in metres; its origin is between the ears. It is the man's or the woman's,
    with the 52 face units as shape keys if `units` is set. Returns the skin; eyeballs, teeth, tongue, lashes and hair
    are its children.
    """
    head = load_head(WOMAN_FILE if woman else None)
    materials = head_materials(woman=woman)
    mesh = _mesh(name, head.vertices, head.faces, head.uv, materials["skin"])
    write_landmarks(mesh, head.landmarks)
    mesh.materials.append(mouth_material())
    mesh.polygons.foreach_set("material_index", head.deep_in_mouth.astype(np.int32))
    skin = bpy.data.objects.new(name, mesh)
    collection = bpy.data.collections.new(name)
    context.collection.children.link(collection)
    collection.objects.link(skin)
    _subdivide_in_renders(skin)
    write_regions(skin, head.regions)
    parts = [add_part(collection, skin, part, materials[part.name]) for part in head.parts]
    lashes = mesh_of(parts[PART_NAMES.index("lashes")])
    write_kinds(lashes, np.full(len(lashes.vertices), Part.ON_SKIN))
    attach(skin, {part.name: obj for part, obj in zip(head.parts, parts, strict=True)})
    if units:
        _add_units(skin, head.vertices, head.unit_names, head.units)
        for obj, part in zip(parts, head.parts, strict=True):
            _add_units(obj, part.vertices - part.pivot, head.unit_names, part.units)
    else:
        out = head.unit_names.index(TONGUE_KEY)
        for obj, part in zip(parts, head.parts, strict=True):
            if part.name == "tongue":
                _add_units(obj, part.vertices - part.pivot, (TONGUE_KEY,), part.units[out : out + 1])
    select_alone(context, skin)
    return skin


def built_in_head_of(skin: bpy.types.Object) -> Head | None:
    """Return the built-in head whose skin an object is, with its vertices at rest where they were; None if none."""
    if not any(PART_PROPERTY in child for child in skin.children):
        return None
    vertices = _vertices_of(skin)
    heads = (load_head(), load_head(WOMAN_FILE))
    return next((head for head in heads if _are_same(head.vertices, vertices)), None)


def _are_same(known: NDArray[np.float32], vertices: NDArray[np.float32]) -> bool:
    return known.shape == vertices.shape and bool(np.allclose(known, vertices, atol=_MOVED))


def add_missing_units(skin: bpy.types.Object) -> None:
    """Add the 52 face units as shape keys to a built-in head whose skin has no keys of the user, and to its lashes."""
    if key_names(skin) or (head := built_in_head_of(skin)) is None:
        return
    _add_units(skin, head.vertices, head.unit_names, head.units)
    lashes = head.part("lashes")
    for child in skin.children:
        if child.get(PART_PROPERTY) == lashes.name and _are_same(lashes.vertices - lashes.pivot, _vertices_of(child)):
            _add_units(child, lashes.vertices - lashes.pivot, head.unit_names, lashes.units)


def _vertices_of(obj: bpy.types.Object) -> NDArray[np.float32]:
    return read_vertices(mesh_of(obj)) if obj.type == "MESH" else np.empty((0, 3), dtype=np.float32)


def _mesh(
    name: str,
    vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    uv: NDArray[np.float32],
    material: bpy.types.Material,
) -> bpy.types.Mesh:
    """Create a smooth-shaded mesh from (V, 3) vertices in the head frame and (F, 4) faces padded with -1."""
    mesh = bpy.data.meshes.new(name)
    corner = faces >= 0
    counts = corner.sum(axis=1)
    mesh.vertices.add(len(vertices))
    mesh.loops.add(int(counts.sum()))
    mesh.polygons.add(len(faces))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(to_blender(vertices), dtype=np.float32).reshape(-1))
    mesh.loops.foreach_set("vertex_index", faces[corner].astype(np.int32))
    mesh.polygons.foreach_set("loop_start", (np.cumsum(counts) - counts).astype(np.int32))
    mesh.polygons.foreach_set("loop_total", counts.astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), dtype=bool))
    layer = mesh.uv_layers.new(name=UV_MAP)
    layer.data.foreach_set("uv", np.ascontiguousarray(uv[corner], dtype=np.float32).reshape(-1))
    mesh.materials.append(material)
    mesh.update(calc_edges=True)
    return mesh


def _subdivide_in_renders(obj: bpy.types.Object) -> None:
    """Add a subdivision for renders only: in the viewport it would take far longer than the rest of a live frame."""
    modifier = obj.modifiers.new("Subdivision", "SUBSURF")
    assert isinstance(modifier, bpy.types.SubsurfModifier)
    modifier.levels, modifier.render_levels, modifier.show_viewport = 1, _RENDER_LEVELS, False


def add_part(
    collection: bpy.types.Collection, parent: bpy.types.Object, part: HeadPart, material: bpy.types.Material
) -> bpy.types.Object:
    """Add a child of `parent` whose origin is the part's pivot."""
    mesh = _mesh(PART_OBJECTS[part.name], part.vertices - part.pivot, part.faces, part.uv, material)
    obj = bpy.data.objects.new(PART_OBJECTS[part.name], mesh)
    obj[PART_PROPERTY] = part.name
    collection.objects.link(obj)
    obj.parent = parent
    obj.location = to_blender(part.pivot).tolist()
    return obj


def _add_units(
    obj: bpy.types.Object, rest: NDArray[np.float32], names: tuple[str, ...], units: NDArray[np.float32]
) -> None:
    """Add shape keys of all units to a part that any of them moves, including those that leave this part unchanged, as
    programs that drive ARKit's 52 keys look each of them up by name.
    """
    if not units.any():
        return
    if mesh_of(obj).shape_keys is None:
        obj.shape_key_add(name="Basis", from_mix=False)
    for name, offsets in zip(names, units, strict=True):
        key = obj.shape_key_add(name=name, from_mix=False)
        points = np.ascontiguousarray(to_blender(rest + offsets), dtype=np.float32)
        key.points.foreach_set("co", points.reshape(-1))
        key.value = 0.0  # since Blender 5.0 the default is 1
