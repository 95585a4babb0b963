"""Driving of a head by a tracked face: pose, displacements of its landmarks, jaw and gaze (method.md, section 4)."""
