"""Images and videos: capture, sizes, and where sound and images start."""
