"""From the displacements of a head's landmarks to every vertex (METHOD sections 5 and 6)."""
