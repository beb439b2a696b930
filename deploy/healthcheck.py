"""Ends with 0 when the gateway's loop turns: it hears what the gateway says to systemd's watchdog, without systemd.

A gateway that hangs is silent, and so is one that has ended; one that waits for its sensor is alive.
"""

import os
import socket
import sys
import time
from pathlib import Path


def hear(path: str, timeout_s: float) -> bool:
    """Tell whether the loop says within this time that it has made a turn. path: NOTIFY_SOCKET of the gateway."""
    Path(path).unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as station:
        station.bind(path)
        end = time.monotonic() + timeout_s
        try:
            while (left_s := end - time.monotonic()) > 0:
                station.settimeout(left_s)
                if station.recv(64) == b"WATCHDOG=1":
                    return True
        except TimeoutError:
            pass
        finally:
            Path(path).unlink()
    return False


if __name__ == "__main__":
    sys.exit(0 if hear(os.environ["NOTIFY_SOCKET"], timeout_s=25.0) else "the gateway's loop does not turn")
