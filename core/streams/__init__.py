"""Faces over the network: protocols, addresses and trust, a source that receives faces, and senders (streams.md)."""
