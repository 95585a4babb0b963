"""From the displacements of a head's landmarks to every vertex (docs/method.md, section 5)."""
