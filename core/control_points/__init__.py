"""Control points: selected for a take or by hand, and saved (method.md, section 6)."""
