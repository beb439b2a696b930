"""A TCP port of this machine for one test alone."""

import atexit
import socket


def free_port() -> int:
    """Of the loopback address. Nobody listens there, and until this process ends the system gives the port only to a
    server that names it and allows that its address is reused, as all servers of the tests do."""
    one = socket.socket()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    one.bind(("127.0.0.1", 0))
    atexit.register(one.close)
    return int(one.getsockname()[1])
