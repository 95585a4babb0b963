"""Heads: landmarks, regions, lids, lips and eyeballs of a mesh; the built-in head (method.md, section 7)."""
