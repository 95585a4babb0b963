"""Constrained local model: from an image to 66 landmarks, head pose and shape (docs/method.md, section 3)."""
