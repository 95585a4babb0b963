"""The commands `track` and `puppet`."""
