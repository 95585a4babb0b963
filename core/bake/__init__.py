"""What a driven take becomes as animation, computed without Blender: weights of keys, tables, clean curves, caches."""
