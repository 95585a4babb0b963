"""Driving of a head by a tracked face: displacements, pose, jaw and gaze (docs/method.md, section 4)."""
