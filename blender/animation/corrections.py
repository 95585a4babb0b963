"""Corrections of a bake: an action that is added to it, on which the user keys shape keys and bones.

A bake writes to NLA tracks below it, so that a new bake replaces the old one and leaves the corrections.
"""

from __future__ import annotations

import bpy

from ...core.errors import HeadError
from ..actions import baked_paths, check_curves, sink_bake
from ..characters import Member, members_of
from ..fcurves import CharacterAction, curves_in, is_layer, make_actions_own, owned_paths
from ..meshes import key_names, mesh_of
from ..names import LAYER_PROPERTY
from .bake import animated_owners
from .bake_keys import family_keys, following_paths, value_path
from .targets import own_targets


def has_layer(head: bpy.types.Object) -> bool:
    """Return whether a head has a layer of corrections."""
    return any(is_layer(owner.animation_data) for owner in _owners(head))


def can_be_corrected(head: bpy.types.Object) -> bool:
    """Return whether a head has a bake of shape keys or its pose, and no layer of corrections yet."""
    return not has_layer(head) and any(baked_paths(owner) for owner in _owners(head))


def add_layer(head: bpy.types.Object) -> str:
    """Add a layer of corrections to a baked head, and return the name of its action.

    What plays on the character goes onto NLA tracks. Other meshes of the head follow its shape keys of the same names
    from now on, so that they are corrected too. Raises HeadError if there is no bake, or there is a layer already.
    """
    owners = _owners(head)
    if not can_be_corrected(head):
        raise HeadError(
            "{name} has no bake to correct, or has corrections already. Bake a take to shape keys first.",
            name=head.name,
        )
    for owner in owners:
        check_curves(owner)
    make_actions_own(owners)
    members = members_of(head)
    for member in members[1:]:
        _let_follow(member, members)
    layer = CharacterAction(f"{head.name} Corrections", owners, LAYER_PROPERTY)
    for owner in owners:
        if isinstance(owner, bpy.types.Key) and owner != mesh_of(head).shape_keys:
            continue  # follows the head, or shows residual keys that nobody corrects
        sink_bake(owner)
        layer.give(owner, f"{owner.name} Corrections")
        data = owner.animation_data
        assert data is not None
        # Combine would subtract the default of a shape key's value, which is 1 from Blender 5.0 on.
        data.action_blend_type = "ADD" if isinstance(owner, bpy.types.Key) else "COMBINE"
        owner[LAYER_PROPERTY] = True
    return layer.name


def remove_layer(head: bpy.types.Object) -> None:
    """Remove the layer of corrections of a head; its bake stays on NLA tracks."""
    for owner in _owners(head):
        data = owner.animation_data
        if data is not None and is_layer(data):
            data.action = None
            data.action_blend_type = "REPLACE"
        if LAYER_PROPERTY in owner:
            del owner[LAYER_PROPERTY]


def _owners(head: bpy.types.Object) -> list[bpy.types.ID]:
    return animated_owners(head, own_targets(head))


def _let_follow(member: Member, members: list[Member]) -> None:
    """Let the shape keys of a mesh follow those of the head, unless a driver moves them already."""
    keys, leading = mesh_of(member.obj).shape_keys, mesh_of(members[0].obj).shape_keys
    if keys is None or leading is None:
        return
    following = following_paths(keys, family_keys(members))
    driven = {driver.data_path for driver in keys.animation_data.drivers} if keys.animation_data else set()
    fcurves, owned = curves_in(keys.animation_data), owned_paths(keys.animation_data)
    for name in set(key_names(member.obj)) & set(key_names(members[0].obj)):
        path = value_path(name)
        if path in following or path in driven:
            continue
        if (curve := fcurves.find(path) if fcurves else None) is not None:
            if path not in owned:
                continue  # the user's own
            fcurves.remove(curve)
        added = keys.driver_add(path)
        assert isinstance(added, bpy.types.FCurve) and added.driver is not None
        added.driver.type = "SUM"
        target = added.driver.variables.new().targets[0]
        target.id_type, target.id, target.data_path = "KEY", leading, path
