"""Recordings of other programs, as takes."""
