"""Driving of a head by a tracked face: pose, displacements, and all vertices (method.md, sections 4 to 6)."""
