"""Ports for tests, that nobody else takes between their choice and their use.

A port of the kernel's choosing (port 0) may be given to any outgoing connection as soon as it is let go of. These are
below the range that the kernel chooses from, and each process begins at another one.
"""

import os
import socket
from itertools import count

LOWEST, HIGHEST = 10_000, 30_000
_numbers = count(os.getpid() * 37)


def free_port(host: str = "127.0.0.1") -> int:
    """A port that is free for TCP and UDP, other than any that this process had before."""
    while True:
        port = LOWEST + next(_numbers) % (HIGHEST - LOWEST)
        with (
            socket.socket(socket.AF_INET, socket.SOCK_STREAM) as stream,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as datagrams,
        ):
            try:
                stream.bind((host, port))
                datagrams.bind((host, port))
            except OSError:
                continue
        return port


def multicast() -> str:
    """A bus of datagrams of this test's own."""
    return f"udp_multicast:239.74.163.2:{free_port('')}"
