"""Takes: what was tracked, on disk and in memory, before any head is chosen."""
