"""The face: its 66 landmarks, apertures, rotations, and the names of coefficients and actions."""
