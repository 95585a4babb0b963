"""From the displacements of a head's landmarks to all its vertices (method.md, section 5)."""
