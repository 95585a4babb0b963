"""Batches: many clips, each in a process of its own, here or on other machines, with one report."""
