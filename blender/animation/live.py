"""Heads during a session: what is displayed on their meshes, and the pose of head, eyes, teeth and tongue."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.drive.driver import HeadFrame
from ...core.errors import HeadError, messages
from ...core.rigs.rig_map import RigMap
from ..characters import members_of
from ..contexts import scene_of
from ..controls.stored import has_controls, used_controls
from ..fcurves import make_actions_own
from ..meshes import exists, keys_of, mesh_of
from ..names import CONTROLS_PROPERTY, PART_PROPERTY
from ..own_pose import live_as, move_own, note_name
from ..switching import bake_of
from .applied import AppliedPose
from .aside import moving, restore, set_aside, values_aside
from .bake import EYE_PARTS, JAW_PARTS, has_tongue, show_tongue
from .bake_keys import family_keys, following_paths
from .carried import carried_targets
from .live_controls import LiveControls
from .live_keys import LiveValues
from .live_mesh import LiveMesh, changed
from .targets import PoseTarget, own_targets, require_bone

FlatMeshes = Sequence[NDArray[np.floating[Any]]]
"""Arrays for `foreach_set`, one for each mesh of a head; or what shows the frame by its controls."""
_DELTAS = ("delta_location", "delta_rotation")
"""Prefixes of the data paths of the channels that pose an object."""
_TARGET_LABELS = messages({"head": "Pose Object", "eye_left": "Left Eye", "eye_right": "Right Eye"})
"""Labels of the fields in which targets are chosen."""


@dataclass
class Follow:
    """Whether a head follows the performer's rotation and translation."""

    rotation: bool = True
    translation: bool = False


@dataclass(eq=False)
class LiveHeadObject:
    """A head that displays a performance.

    Parameters
    ----------
    obj : bpy.types.Object
        A mesh that can be driven.
    targets : mapping
        "head", and optionally "eye_left" and "eye_right", which replace the eyes of `obj`.
    follow : Follow, optional
    keys : tuple of str
        The shape keys whose values show the performance, in the order of `HeadFrame.keys`; () for the live key.
    controls : RigMap, optional
        The controls of the character's own rig that show the performance instead.

    Raises
    ------
    HeadError
        If the object is not a mesh, is linked, or has absolute shape keys, or a control or its bone is missing.
    """

    obj: bpy.types.Object
    targets: Mapping[str, PoseTarget]
    follow: Follow = field(default_factory=Follow)
    keys: tuple[str, ...] = ()
    controls: RigMap | None = None

    def __post_init__(self) -> None:
        self._controls = None if self.controls is None else LiveControls(self.obj, self.controls)
        self._meshes = [LiveMesh(member) for member in members_of(self.obj)]
        self._name = self.obj.name
        require_bone(self.obj, self.targets)
        self._parts = [(child, _kind(child)) for child in self.obj.children if _kind(child)]
        self._carried = carried_targets(self.obj, self.targets["head"]) if "head" in self.targets else []
        self._moving: list[PoseTarget] = []
        self._applied: list[AppliedPose] = []
        self._shown = self._skipped = False
        objects = [self.obj, *(one for target in self.targets.values() for one in (target.obj, target.head))]
        self._uids = {id(obj): obj.session_uid for obj in objects if obj is not None}

    def found_again(self) -> LiveHeadObject | None:
        """Return the same head after an undo, which makes Python's references invalid; None if it is not there."""
        there = {obj.session_uid: obj for obj in bpy.data.objects}
        obj = there.get(self._uids[id(self.obj)])
        if obj is None or obj.type != "MESH":
            return None
        targets = {}
        for name, target in self.targets.items():
            place = there.get(self._uids[id(target.obj)])
            head = None if target.head is None else there.get(self._uids[id(target.head)])
            if place is not None:
                targets[name] = replace(target, obj=place, head=head)
        controls = self.controls
        if controls is not None and has_controls(obj):
            controls = used_controls(obj)  # the undo may have renamed their objects
        return LiveHeadObject(obj, targets, self.follow, self.keys, controls)

    @property
    def rigs(self) -> list[bpy.types.Object]:
        """The objects whose controls show the performance."""
        return [] if self._controls is None else self._controls.owners

    @property
    def vertices(self) -> int:
        """Vertex count of all its meshes at the start of the session."""
        return int(self._meshes[-1].member.part.stop)

    @property
    def prepare(self) -> Callable[[HeadFrame], FlatMeshes]:
        """Function that prepares a frame for `write` without touching Blender's data, for the worker's thread."""
        members = [shown.member for shown in self._meshes]

        def prepared(frame: HeadFrame) -> FlatMeshes:
            if (controls := self._controls) is not None:
                return controls.solve(frame)
            return [member.local(frame.vertices) for member in members]

        return prepared

    @property
    def gone(self) -> bool:
        """Whether the head was deleted."""
        return not exists(self.obj)

    @property
    def left_in_file(self) -> bool:
        """Whether the open file has the head as a session displays it, as after undoing a step of the session."""
        displayed = any(shown.left_in_file for shown in self._meshes)
        return displayed or any(CONTROLS_PROPERTY in owner for owner in self.rigs)

    @property
    def blocks(self) -> set[bpy.types.ID]:
        """The data-blocks that the session changes."""
        meshes = [mesh for shown in self._meshes if exists(mesh := shown.mesh)]
        keys = [mesh.shape_keys for mesh in meshes if mesh.shape_keys is not None]
        objects = [shown.obj for shown in self._living_meshes()]
        targets = [target.obj for target in self._living_targets()]
        return {*self._owners(), *targets, *objects, *meshes, *keys}

    def attach(self) -> None:
        """Add the live shape keys, and mute an earlier bake of the head; does nothing if the head was deleted.

        Raises HeadError if a mesh was replaced or changed so that it can no longer be driven.
        """
        if self.gone:
            return
        for shown in self._living_meshes():
            shown.require_same()
        make_actions_own(self._animated_owners())
        for shown in self._living_meshes():
            if self._controls is None or mesh_of(shown.obj).shape_keys is not None:
                by_values = self.keys or self._controls is not None
                values = self._values_of(shown.obj) if by_values else None
                shown.attach(values, by_rig=self._controls is not None)
        if self._controls is not None:
            self._controls.attach()
        for target in self._living_targets():
            target.begin()
        for owner in self._owners():
            channels = (
                *_DELTAS,
                *(path for target in self._living_targets() if target.obj == owner for path in target.channels),
                *([] if self._controls is None else self._controls.paths(owner)),
            )
            set_aside(owner, [*moving(owner, channels), *bake_of(owner)])
        self._moving = [target for target in self._carried if not target.bone and values_aside(target.obj, _DELTAS, 0)]
        self._applied = [AppliedPose(target) for target in self._living_targets()]
        self._shown = True

    @property
    def is_stale(self) -> bool:
        """Whether a mesh was in Edit Mode when the last frame was to be displayed, and no longer is."""
        return self._skipped and not self._is_edited

    @property
    def _is_edited(self) -> bool:
        return any(shown.obj.mode == "EDIT" for shown in self._living_meshes())

    def newly_applied(self) -> list[str]:
        """Return, once, the names of objects and bones whose pose became part of their rest shape since a frame."""
        return [watch.name for watch in self._applied if watch.happened()]

    def taught_controls(self) -> dict[str, float]:
        """Return what the user has changed of the controls that show a frame, as `LiveControls.taught`."""
        return {} if self._controls is None else self._controls.taught()

    def _values_of(self, obj: bpy.types.Object) -> LiveValues | None:
        if (keys := mesh_of(obj).shape_keys) is None:
            return None
        family = family_keys([shown.member for shown in self._living_meshes()])
        names = self.keys if self._controls is None else ()
        return LiveValues(keys, names, following_paths(keys, family))

    def _owners(self) -> list[bpy.types.ID]:
        """Return the data-blocks whose animation is set aside: of the pose, and of the tongue."""
        parts = [child for child, _ in self._living_parts()]
        posed = [target.obj for target in (*self._carried, *self.targets.values()) if target.exists]
        tongues = [keys_of(tongue) for tongue in filter(has_tongue, parts)]
        return list(dict.fromkeys([*([] if self.gone else [self.obj]), *parts, *posed, *tongues, *self.rigs]))

    def drive_by(self, keys: tuple[str, ...], controls: RigMap | None = None) -> None:
        """Show the following frames through the values of `keys`, through controls, or through the live key."""
        if keys != self.keys or controls is not self.controls:
            shown = self._shown
            self.detach(keep=False, blocks=False)
            self.keys, self.controls = keys, controls
            self._controls = None if controls is None else LiveControls(self.obj, controls)
            if shown:
                self.attach()

    def write(self, frame: HeadFrame, flat: FlatMeshes | None = None) -> None:
        """Display a frame; does nothing in Edit Mode, and skips parts that were deleted.

        `flat` is `prepare(frame)`, if it is already computed. Raises HeadError if the mesh was changed so that it can
        no longer be driven, or an object or bone that follows the pose was deleted.
        """
        self._skipped = self._is_edited
        if self.obj.mode == "EDIT":
            return
        if len(frame.vertices) != self.vertices:
            raise changed(self._name)
        for shown in self._living_meshes():
            shown.require_same()
        self._follow_renamed()
        for name, target in self.targets.items():
            if not target.exists:
                require_bone(self.obj, own_targets(self.obj) if name == "head" else {})
                raise HeadError(
                    "The object or bone chosen as {label} was deleted. Choose another one in Puppet > "
                    "Head and Eyes, or clear that field, and start again.",
                    label=_TARGET_LABELS[name],
                )
        rotation = frame.rotation if self.follow.rotation else None
        translation = frame.translation if self.follow.translation else None
        for target in self._carried:
            if target.exists:
                if target in self._moving:  # the pose is added to where the user's animation places the object
                    frame_now = scene_of(target.obj).frame_current_final
                    move_own(target.obj, values_aside(target.obj, _DELTAS, frame_now))
                target.apply(rotation, translation)
        for child, kind in self._living_parts():
            if kind not in self.targets:
                PoseTarget(child).apply(frame.jaw if kind == "jaw" else frame.gaze[EYE_PARTS.index(kind)], None)
            show_tongue(child, frame.tongue)
        for side, eye in enumerate(EYE_PARTS):
            if eye in self.targets:
                self.targets[eye].apply(frame.gaze[side], None)
        # Last, as controls are corrected by what head and gaze do to the face. If the numbers differ, the frame was
        # computed before the way of driving was changed.
        if len(frame.keys) == len(self.keys):
            self._write_face(frame, flat)
        for watch in self._applied:
            watch.note()

    def _follow_renamed(self) -> None:
        """Find the bones again that were renamed, which the session's mark on them tells."""
        if all(target.exists for target in self.targets.values()):
            return
        own = {} if self.gone else own_targets(self.obj)
        for name, target in self.targets.items():
            if not target.exists and exists(target.obj) and target.obj.pose is not None:
                places = (own.get(name), *(replace(target, bone=bone.name) for bone in target.obj.pose.bones))
                marked = (one for one in places if one is not None and one.bone and live_as(one.owner) == target.bone)
                self.targets = {**self.targets, name: next(marked, target)}
                if self.targets[name].exists:
                    note_name(self.targets[name].owner)
        if "head" in self.targets and self.targets["head"].exists:
            self._carried = carried_targets(self.obj, self.targets["head"])
        self._applied = [AppliedPose(target) for target in self._living_targets()]

    def _write_face(self, frame: HeadFrame, flat: FlatMeshes | None) -> None:
        """Display the face; what was prepared before the way of driving was changed is prepared again."""
        sizes = [3 * len(shown.mesh.vertices) for shown in self._meshes]
        if self._controls is not None:
            sizes = self._controls.sizes
        if flat is None and self._controls is not None:
            self._controls.renew()
        if flat is None or [len(each) for each in flat] != sizes:
            flat = self.prepare(frame)
        if self._controls is not None:
            self._controls.write(*flat)
            return
        for shown, positions in zip(self._meshes, flat, strict=True):
            if not shown.gone:
                shown.write(positions, frame.keys)

    def detach(self, *, keep: bool, blocks: bool = True) -> bool:
        """Stop displaying frames, and return whether a data-block was removed, so that an undo step must be pushed.

        The pose and the live shape key are kept if `keep` is set; otherwise everything that still exists is restored.
        `blocks` is whether data-blocks may be removed, which is not allowed between two undo steps
        (`blender.contexts`).
        """
        if not self._shown:
            return False
        self._shown, self._applied = False, []
        if self._controls is not None:
            self._controls.detach(keep=keep)
        for owner in self._owners():
            restore(owner)
        removed = [shown.detach(keep=keep, blocks=blocks and not self._goes(shown)) for shown in self._meshes]
        for target in self._living_targets():
            if keep:
                target.keep()
            else:
                target.rest()
        if keep:
            return False
        for child, _ in self._living_parts():
            show_tongue(child, 0.0)
        return any(removed)

    def _goes(self, shown: LiveMesh) -> bool:
        """Return whether a mesh will be deleted, as its head was."""
        return self.gone and not shown.gone and PART_PROPERTY in shown.obj

    def _living_meshes(self) -> list[LiveMesh]:
        return [shown for shown in self._meshes if not shown.gone]

    def _living_targets(self) -> list[PoseTarget]:
        parts = [PoseTarget(child) for child, _ in self._living_parts()]
        targets = dict.fromkeys((*self._carried, *self.targets.values(), *parts))
        return [target for target in targets if target.exists]

    def _animated_owners(self) -> Iterator[bpy.types.ID]:
        """Yield the data-blocks whose animation is muted during the session."""
        yield self.obj
        yield from (target.obj for target in self._living_targets())
        yield from () if self._controls is None else self._controls.owners
        for obj in (*(shown.obj for shown in self._living_meshes()), *(child for child, _ in self._living_parts())):
            if (keys := getattr(obj.data, "shape_keys", None)) is not None:
                yield keys

    def _living_parts(self) -> list[tuple[bpy.types.Object, str]]:
        return [(child, kind) for child, kind in self._parts if exists(child)]


def require_one_left(heads: Sequence[LiveHeadObject]) -> None:
    """Raise HeadError if all of `heads` were deleted."""
    if all(shown.gone for shown in heads):
        raise HeadError("The head was deleted. Add or select another one, and restart the puppet.")


def _kind(child: bpy.types.Object) -> str:
    part = str(child.get(PART_PROPERTY, ""))
    return "jaw" if part in JAW_PARTS else part if part in EYE_PARTS else ""
