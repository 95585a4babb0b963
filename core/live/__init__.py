"""Live: where frames come from as they happen, the worker that tracks them, and calibration before a camera."""
