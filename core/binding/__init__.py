"""Landmarks on an unlabelled head, from what the tracker sees on it and from a template that is bent to it."""
