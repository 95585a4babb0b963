"""Constrained local model: from an image to 66 landmarks, head pose and shape (method.md, section 3)."""
