"""A PLC over Modbus TCP that asks as fast as it may, in a process of its own."""

import socket
import struct
import time
from multiprocessing.connection import Connection

ID = b"\x10\0\0\0\2\4"
TRIGGER, NO_TRIGGER = b"\x05\0\0\xff\0", b"\x0f\0\0\0\3\1\0"
ACKNOWLEDGE = b"\x05\0\1\xff\0"
READY, STATUS = b"\x02\0\0\0\1", b"\x04\0\0\0\3"


class Tcp:
    """One connection."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), 5)

    def ask(self, request: bytes) -> bytes:
        self.socket.sendall(struct.pack(">HHHB", 1, 0, len(request) + 1, 1) + request)
        header = self.receive(7)
        return self.receive(struct.unpack(">HHHB", header)[2] - 1)

    def receive(self, size: int) -> bytes:
        received = b""
        while len(received) < size:
            more = self.socket.recv(size - len(received))
            assert more
            received += more
        return received


def shake_hands(port: int, passes: int, results: Connection) -> None:
    """Do handshakes until so many have passed. Sends id, time of the trigger and of the answer of each pass, and how
    long each read took; times are monotonic nanoseconds, which processes of one machine share."""
    tcp, number = Tcp(port), 0
    answered: list[tuple[int, int, int]] = []
    reads_ns: list[int] = []
    while len(answered) < passes:
        while not tcp.ask(READY)[2]:
            time.sleep(0.01)
        number += 1
        tcp.ask(NO_TRIGGER)
        tcp.ask(ID + struct.pack(">I", number))
        asked_ns = time.monotonic_ns()
        tcp.ask(TRIGGER)
        while True:
            sent_ns = time.monotonic_ns()
            (word,) = struct.unpack(">H", tcp.ask(STATUS)[2:4])
            seen_ns = time.monotonic_ns()
            reads_ns.append(seen_ns - sent_ns)
            if word & 1 << 2:
                break
            time.sleep(0.001)
        if word & 1 << 3:  # a pass waits for the database, a fail is shown before
            answered.append((number, asked_ns, seen_ns))
        tcp.ask(ACKNOWLEDGE)
    tcp.socket.close()
    results.send((answered, reads_ns))
