"""Takes: tracked performances, in memory and on disk, independent of any head (method.md, section 8)."""
