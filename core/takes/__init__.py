"""Takes: tracked performances, independent of any head, in memory and on disk (method.md, section 8)."""
