"""Servers of the handshake for PLCs."""
