"""Names under which the data of a head is stored in a .blend file; changing one breaks the files of users."""

LANDMARKS_PROPERTY = "facemime_landmarks"
"""Custom property of the mesh: 66 vertex indices, in the order of `core.landmarks`."""

COUNT_PROPERTY = "facemime_vertex_count"
"""Custom property of the mesh: its vertex count when the landmarks were bound."""

MARKS_PROPERTY = "facemime_marks"
"""Custom property of the mesh: pairs of iBUG number and vertex that the user marked before binding."""

SELECTION_PROPERTY = "facemime_control_points"
"""Custom property of the mesh: the selected control points, as `core.control_points.select.to_json` writes them."""

LIVE_PROPERTY = "facemime_live"
"""Custom property of the mesh during a live session: 1, or 2 if it had no shape keys before."""

PART_PROPERTY = "facemime_part"
"""Custom property of a child object: which part of the head it is, a key of `PART_OBJECTS`."""

REGION_GROUPS = ("Facemime Upper", "Facemime Middle", "Facemime Lower")
"""Vertex groups of the three regions, in the order of `core.heads.regions.REGIONS`."""

EYES_GROUP = "Facemime Eyes"
"""Vertex group of eyes that were cut out of the skin; they are in no region, and the lids slide over them."""

PART_OBJECTS = {
    "eye_left": "Eye.L",
    "eye_right": "Eye.R",
    "teeth_upper": "Teeth.Upper",
    "teeth_lower": "Teeth.Lower",
    "tongue": "Tongue",
}
"""Object name of each part. Left and right are the head's own."""

TONGUE_KEY = "tongueOut"
"""Shape key of the tongue, by which it comes out."""

UV_MAP = "UVMap"
