"""Live sessions: sources of frames, the worker that tracks them, and calibration in front of a camera."""
