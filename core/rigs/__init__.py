"""Rigs of any kind: what their controls do to a face, and the values that show a performance."""
