"""Names under which a head's data lies in a .blend file; changing one orphans the files that users have saved."""

LANDMARKS_PROPERTY = "facemime_landmarks"
"""Custom property of the mesh: 66 vertex indices, in the order of `core.landmarks`."""

PART_PROPERTY = "facemime_part"
"""Custom property of a child object that says which part of the head it is: one of `PART_OBJECTS`' keys."""

REGION_GROUPS = ("Facemime Upper", "Facemime Middle", "Facemime Lower")
"""Vertex groups of the three regions, in the order of `core.head.REGION_NAMES`."""

PART_OBJECTS = {
    "eye_left": "Eye.L",
    "eye_right": "Eye.R",
    "teeth_upper": "Teeth.Upper",
    "teeth_lower": "Teeth.Lower",
    "tongue": "Tongue",
}
"""Part to object name. Left and right are the performer's own."""

UV_MAP = "UVMap"
