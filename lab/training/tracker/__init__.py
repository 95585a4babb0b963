"""Trains the tracker's model file: `python -m lab.training.tracker`."""
