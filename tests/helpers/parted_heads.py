"""Heads whose eyes, teeth and tongue are separate parts."""

from dataclasses import replace

import numpy as np

from facemime.core.face.landmarks import LOWER_LIPS, from_ibug
from facemime.core.heads.built_in import load_head
from facemime.core.heads.rig import FaceParts, HeadRig, Part, built_in_head
from tests.helpers.built_in import POINTS, UNIT

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


GUM_ROWS, GUM_COLUMNS = 6, 9


def with_gums(room: float) -> HeadRig:
    """The built-in head with a plate of lower teeth and gums behind the lips, from above to below the lower one."""
    rig = built_in_head()
    top = POINTS[LOWER_LIPS].mean(axis=0)
    chin = POINTS[from_ibug([8])[0]]
    x = top[0] + UNIT * np.linspace(-0.12, 0.12, GUM_COLUMNS)
    y = np.linspace(top[1] - 0.06 * UNIT, top[1] + 0.6 * (chin[1] - top[1]), GUM_ROWS)
    plate = np.stack([*np.meshgrid(x, y), np.full((GUM_ROWS, GUM_COLUMNS), top[2] + room * UNIT)], axis=-1).reshape(
        -1, 3
    )
    first = len(rig.vertices) + np.array(
        [r * GUM_COLUMNS + c for r in range(GUM_ROWS - 1) for c in range(GUM_COLUMNS - 1)]
    )
    faces = first[:, None] + np.array([0, 1, GUM_COLUMNS + 1, GUM_COLUMNS])
    kinds = np.repeat([Part.SKIN, Part.TEETH_LOWER], [len(rig.vertices), len(plate)]).astype(np.int8)
    return replace(rig, parts=FaceParts(kinds, plate.astype(np.float32), faces))
