"""Trains the tracker's model file: `python -m training.tracker`."""
