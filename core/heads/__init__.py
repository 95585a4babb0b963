"""Heads: landmarks, regions, lids, lips and eyeballs of a mesh; the built-in head and FaceGen's (docs/method.md, 7)."""
