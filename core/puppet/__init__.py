"""Jobs and performances: which face moves which head, how, and with which output."""
