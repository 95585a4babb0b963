"""Names under which a head's data lies in a .blend file; changing one orphans the files that users have saved."""

LANDMARKS_PROPERTY = "facemime_landmarks"
"""Custom property of the mesh: 66 vertex indices, in the order of `core.landmarks`."""

COUNT_PROPERTY = "facemime_vertex_count"
"""Custom property of the mesh: its vertices when the landmarks were bound."""

MARKS_PROPERTY = "facemime_marks"
"""Custom property of the mesh: pairs of iBUG number and vertex that the user marked before binding."""

SELECTION_PROPERTY = "facemime_control_points"
"""Custom property of the mesh: the chosen control points and why, as `core.control_points.to_json` writes them."""

LIVE_PROPERTY = "facemime_live"
"""Custom property of the mesh while it is shown live: 1, or 2 where it had no shape keys before."""

PART_PROPERTY = "facemime_part"
"""Custom property of a child object that says which part of the head it is: one of `PART_OBJECTS`' keys."""

REGION_GROUPS = ("Facemime Upper", "Facemime Middle", "Facemime Lower")
"""Vertex groups of the three regions, in the order of `core.head.REGION_NAMES`."""

EYES_GROUP = "Facemime Eyes"
"""Vertex group of eyes that were cut out of the skin: they are in no region, and the lids slide over them."""

PART_OBJECTS = {
    "eye_left": "Eye.L",
    "eye_right": "Eye.R",
    "teeth_upper": "Teeth.Upper",
    "teeth_lower": "Teeth.Lower",
    "tongue": "Tongue",
}
"""Part to object name. Left and right are the performer's own."""

UV_MAP = "UVMap"
