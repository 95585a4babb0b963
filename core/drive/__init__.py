"""Driving of a head by a tracked face: displacements, pose, jaw and gaze (method.md, section 4)."""
