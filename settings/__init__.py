"""What a scene and the user keep: properties, their plain values, files."""
