"""Generation of the files in `assets/`. Not part of the extension."""
