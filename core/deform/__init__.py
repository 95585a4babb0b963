"""From landmarks' displacements to every vertex of a mesh (METHOD sections 5 and 6)."""
