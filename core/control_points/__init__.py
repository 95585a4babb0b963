"""Which landmarks control which region: chosen greedily for a take, or by hand, and kept (METHOD section 6)."""
