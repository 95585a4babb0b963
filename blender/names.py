"""Names under which data is stored in a .blend file; changing one breaks the files of users."""

LANDMARKS_PROPERTY = "facemime_landmarks"
"""Custom property of the mesh: 66 vertex indices, in the order of `core.face.landmarks`."""

KEYS_PROPERTY = "facemime_keys"
"""Custom property of a mesh that its shape keys drive, without landmarks: 66 vertices near which they would lie."""

COUNT_PROPERTY = "facemime_vertex_count"
"""Custom property of the mesh: its vertex count when the landmarks were bound."""

MARKS_PROPERTY = "facemime_marks"
"""Custom property of the mesh: pairs of iBUG number and vertex that the user marked before binding."""

SELECTION_PROPERTY = "facemime_control_points"
"""Custom property of the mesh: the selected control points, as `core.control_points.selection.to_json` writes them."""

LIVE_PROPERTY = "facemime_live"
"""Custom property of the mesh during a live session: 1, or 2 if it had no shape keys before."""

VALUES_PROPERTY = "facemime_values"
"""Custom property of shape keys during a live session: their values before it, as JSON."""

CONTROLS_PROPERTY = "facemime_controls"
"""Custom property of an object during a live session: the values of its controls before it, as JSON."""

ASIDE_PROPERTY = "facemime_aside"
"""Custom property of an object or shape keys during a live session: what is muted meanwhile, as JSON."""

PART_PROPERTY = "facemime_part"
"""Custom property of a child object: which part of the head it is, a key of `PART_OBJECTS`."""

PARTS_PROPERTY = "facemime_parts"
"""Custom property of a head: its child objects, by a key of `PART_OBJECTS`."""

PART_ATTRIBUTE = "facemime_part"
"""Attribute of the vertices of a mesh: the part of the face to which each belongs, a `core.heads.rig.Part`."""

LOOKS_PROPERTY = "facemime_look_keys"
"""Custom property of the mesh of an eye: the shape keys that Facemime added to turn it, one per line."""

NECK_PROPERTY = "facemime_neck"
"""Custom property of an armature that was added to turn the head of a character without bones."""

FACEGEN_PROPERTY = "facemime_facegen"
"""Custom property of an object that was imported from a file of FaceGen."""

HEAD_PROPERTY = "facemime_head"
"""Custom property of another mesh of a face: the head to which it belongs."""

ORDER_PROPERTY = "facemime_order"
"""Custom property of another mesh of a face: its place among them, once something that was learnt depends on it."""

ARMATURE_PROPERTY = "facemime_armature"
"""Custom property of a head: the armature that follows its pose."""
BONES_PROPERTY = "facemime_bones"
"""Custom property of a head: the names of its bones by part of the face, and what their marks end with."""
BONE_MARKS_PROPERTY = "facemime_bone"
"""Custom property of a pose bone: the marks by which it is found when it is renamed, one per line."""

PIVOT_PROPERTY = "facemime_pivot"
"""Custom property of a head: the point about which it turns, in the axes of the object; its origin if missing."""

TAKE_PROPERTY = "facemime_take"
"""Custom property of a strip in the Sequencer: that it has the sound of a take."""

RANGE_PROPERTY = "facemime_range"
"""Custom property of a scene: the frame range of the last take, to which Facemime set the scene's."""

OWN_POSE_PROPERTY = "facemime_own_pose"
"""Custom property of an object or a pose bone that a performance poses: the user's own location and rotation."""

CURVES_PROPERTY = "facemime_curves"
"""Custom property of an action: the data paths of the curves that Facemime made, one per line; numbered by slot."""

WRITTEN_PROPERTY = "facemime_written"
"""Custom property of a data-block: a checksum, the index and the data path of each curve that bakes wrote for it, one
per line.
"""

BAKE_PROPERTY = "facemime_character"
"""Custom property of an action that a character plays: that of its bake."""

LAYER_PROPERTY = "facemime_corrections"
"""Custom property of an action that a character plays: that of the user's corrections."""

MUTED_PROPERTY = "facemime_muted"
"""Custom property of a data-block: what bakes muted of its animation, a kind and a data path or a name on each line."""

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
    "lashes": "Lashes",
    "hair": "Hair",
}
"""Object name of each part. Left and right are the head's own."""

TONGUE_KEY = "tongueOut"
"""Shape key that sticks out the tongue."""

BAKED_KEY_PREFIX = "Facemime "
"""Prefix of the names of shape keys that a bake or a live session adds."""

UV_MAP = "UVMap"
