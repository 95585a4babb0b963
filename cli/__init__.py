"""The command `facemime`."""
