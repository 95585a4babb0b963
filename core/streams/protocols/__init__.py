"""Protocols of other programs, and the frame that all are decoded to; no sockets."""
