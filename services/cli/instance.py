"""The name of this process among all workers."""

import os
import socket


def own_host() -> str:
    """Return this machine's name as far as it can be part of an instance's name."""
    host = "".join(letter for letter in socket.gethostname() if letter.isalnum() or letter == "-")[:40]
    return host or "host"


def own_instance() -> str:
    """Return a name for this process that no other has: host name and process number."""
    return f"{own_host()}-{os.getpid()}"
