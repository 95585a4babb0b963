"""Heads whose eyes, teeth and tongue are separate parts."""

from dataclasses import replace

import numpy as np

from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import FaceParts, HeadRig, Part, built_in_head

KINDS = {
    "eye_left": Part.EYE_LEFT,
    "eye_right": Part.EYE_RIGHT,
    "teeth_upper": Part.TEETH_UPPER,
    "teeth_lower": Part.TEETH_LOWER,
    "tongue": Part.TEETH_LOWER,
}
"""What each part within the built-in head is."""


def with_parts() -> HeadRig:
    """The built-in head with eyes, teeth and tongue as separate meshes."""
    head, rig = load_head(), built_in_head()
    start, faces, numbers = len(rig.vertices), [], [np.zeros(len(rig.vertices), dtype=np.int8)]
    parts = [part for part in head.parts if part.name in KINDS]
    for part in parts:
        faces.append(np.where(part.faces >= 0, part.faces + start, -1))
        numbers.append(np.full(len(part.vertices), KINDS[part.name], dtype=np.int8))
        start += len(part.vertices)
    others = np.concatenate([part.vertices for part in parts])
    return replace(rig, parts=FaceParts(np.concatenate(numbers), others, np.concatenate(faces)))
