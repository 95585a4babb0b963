"""How the files in `assets/` are made again. Not part of the extension."""
