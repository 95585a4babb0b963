"""Files: reading within bounds, writing that loses nothing, locks, presets, and how settings are described."""
