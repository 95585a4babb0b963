"""What all other packages use: errors, arrays, files and media, settings, and the landmarks and names of a face."""
