"""From the displacements of a head's landmarks to all its vertices (docs/method.md, section 5)."""
