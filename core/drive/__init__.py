"""From a performer's tracked face to a head: displacements, pose, jaw and gaze, a frame or a take at a time."""
