"""Puppets: jobs and presets; live, sources of frames, the worker that tracks them, and calibration."""
