"""How 3D Viewports show a face that is checked or driven: in its colours, and without bones in front of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import ClassVar

import bpy

from ..characters import objects_of
from ..meshes import mesh_of, posed_bones
from ..surfaces import ShownColours
from .family import armature_of


class FaceDisplay:
    """What is changed in the viewports of all windows until `close`.

    If `bones` is set, bones are hidden, with the objects that are their shapes: importers draw bones as spheres, and
    large rigs put handles in front of the face. Solid viewports that colour objects by their materials show the
    textures, which such a viewport otherwise leaves out. Viewports are found again by their addresses: Python's
    reference to one becomes invalid when the user closes it. What was changed is reverted while a file is saved.
    """

    open: ClassVar[list[FaceDisplay]] = []

    def __init__(self, heads: Iterable[bpy.types.Object], *, bones: bool) -> None:
        self._meshes = [obj.name for head in heads for obj in (head, *objects_of(head))]
        self._bones = bones
        self._with_bones: set[int] = set()
        self._coloured: set[int] = set()
        self._shapes: list[str] = []
        self._colours = self.apply()
        FaceDisplay.open.append(self)

    @property
    def bones(self) -> bool:
        """Whether bones are hidden; may be changed."""
        return self._bones

    @bones.setter
    def bones(self, hidden: bool) -> None:
        if hidden != self._bones:
            self.revert()
            self._bones = hidden
            self._colours = self.apply()

    def apply(self) -> ShownColours:
        """Change the viewports, and return the colours that they show."""
        meshes = [obj for name in self._meshes if (obj := bpy.data.objects.get(name)) is not None]
        colours = ShownColours(mesh_of(obj) for obj in meshes)
        for space in _spaces():
            if self._bones and space.overlay.show_bones:
                self._with_bones.add(space.as_pointer())
                space.overlay.show_bones = False
            if colours.kind and space.shading.type == "SOLID" and space.shading.color_type == "MATERIAL":
                self._coloured.add(space.as_pointer())
                space.shading.color_type = colours.kind
        if self._bones:
            for shape in _shapes(meshes):
                shape.hide_set(True)
                self._shapes.append(shape.name)
        return colours

    def revert(self) -> None:
        """Revert what `apply` changed and the user has not changed since."""
        for space in _spaces():
            if space.as_pointer() in self._with_bones:
                space.overlay.show_bones = True
            if space.as_pointer() in self._coloured and space.shading.color_type == self._colours.kind:
                space.shading.color_type = "MATERIAL"
        for name in self._shapes:
            if (shape := bpy.data.objects.get(name)) is not None and name in bpy.context.view_layer.objects:
                shape.hide_set(False)
        self._colours.revert()
        self._with_bones, self._coloured, self._shapes = set(), set(), []

    def close(self) -> None:
        """Show the viewports as before; may be called twice."""
        if self in FaceDisplay.open:
            FaceDisplay.open.remove(self)
            self.revert()


def _spaces() -> Iterator[bpy.types.SpaceView3D]:
    for screen in bpy.data.screens:
        for area in screen.areas:
            for space in area.spaces:
                if isinstance(space, bpy.types.SpaceView3D):
                    yield space


def _shapes(meshes: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the visible objects that are shapes of bones of the meshes' armatures."""
    armatures = {armature for obj in meshes if (armature := armature_of(obj)) is not None}
    shapes = {bone.custom_shape for armature in armatures for bone in posed_bones(armature)}
    there = bpy.context.view_layer.objects
    return [shape for shape in shapes if shape is not None and shape.name in there and shape.visible_get()]


def _before_saving(*_: object) -> None:
    for display in FaceDisplay.open:
        display.revert()


def _after_saving(*_: object) -> None:
    for display in FaceDisplay.open:
        display.apply()


def _forget(*_: object) -> None:
    FaceDisplay.open.clear()


HANDLERS = {
    "save_pre": _before_saving,
    "save_post": _after_saving,
    "save_post_fail": _after_saving,
    "load_post": _forget,
}


def unregister() -> None:
    """Show the viewports as before."""
    for display in list(FaceDisplay.open):
        display.close()
