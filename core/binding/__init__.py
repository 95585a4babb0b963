"""Landmarks on an unlabelled head: what the tracker sees on it, and a template that is bent to it."""
