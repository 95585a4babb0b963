"""Addresses, datagrams, signatures, certificates and sessions."""
