"""Control points: selected for a take or by hand, and saved (docs/method.md, section 6)."""
