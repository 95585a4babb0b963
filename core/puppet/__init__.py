"""Jobs and performances: which face drives which head, how, and with which outputs."""
