"""A TCP port of this machine that is free now."""

import socket

__all__ = ["free_port"]


def free_port() -> int:
    """Of the loopback address; another program may take it."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])
