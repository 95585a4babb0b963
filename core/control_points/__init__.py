"""Control points: chosen greedily for a take, or by hand, and saved (docs/method.md, section 6)."""
