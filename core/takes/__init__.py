"""Takes: tracked performances, in memory and on disk, independent of any head (docs/method.md, section 8)."""
