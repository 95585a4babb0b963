"""Faces over the network: protocols, a source that receives them, and a sender (streams.md)."""
