"""Settings of scenes and users: properties, their plain values, files."""
