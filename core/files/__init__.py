"""Files: reading within bounds, writing that loses nothing, locks, how settings are described, videos and images."""
