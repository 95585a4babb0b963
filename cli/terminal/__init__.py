"""What every command needs of the terminal and its process: options, outputs, progress, signals, an end."""
