"""Pictures, videos and sound, into Blender and out of it."""
