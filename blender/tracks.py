"""NLA tracks of bakes."""

from __future__ import annotations

import re

import bpy

from .fcurves import owned_paths

TRACK = "Facemime"
"""Name of a bake's NLA tracks, numbered if there are several; a renamed track belongs to the user."""
_TRACK_NAME = re.compile(rf"{TRACK}(\.\d{{3}})?")


def tracks_of_bakes(owner: bpy.types.ID) -> list[bpy.types.NlaTrack]:
    """Return the NLA tracks of `owner` that a bake added."""
    data = owner.animation_data
    return [] if data is None else [track for track in data.nla_tracks if _TRACK_NAME.fullmatch(track.name)]


def tracked_strips(owner: bpy.types.ID) -> list[bpy.types.NlaStrip]:
    """Return the strips on these tracks, among which may be strips of the user."""
    return [strip for track in tracks_of_bakes(owner) for strip in track.strips]


def is_baked(strip: bpy.types.NlaStrip) -> bool:
    """Return whether a bake wrote the action of a strip."""
    return bool(owned_paths(strip))
