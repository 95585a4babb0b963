"""Heads: landmarks, regions, lids, lips and eyeballs of a mesh; the built-in head; FaceGen's files.

See method.md, section 7.
"""
