"""The commands of `facemime` that track a face and move a head."""
