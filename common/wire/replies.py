"""The last answers of a worker, so that a retry of the same request is not computed twice."""

import threading
from collections import OrderedDict
from collections.abc import Hashable

from pydantic import BaseModel

from common.wire.messages import Reply

LARGEST = 32
LARGEST_BYTES = 64 * 2**20


class ReplyCache:
    """Answers by the identity of their request, the oldest forgotten first. Safe to use from several threads.

    An answer larger than ``largest_bytes`` is not kept.
    """

    def __init__(self, *, largest_bytes: int = LARGEST_BYTES) -> None:
        self._replies: OrderedDict[Hashable, tuple[Reply, int]] = OrderedDict()
        self._largest_bytes = largest_bytes
        self._bytes = 0
        self._lock = threading.Lock()

    def find(self, identity: Hashable | None) -> Reply | None:
        """Return the answer that was given to this request, None if there was none."""
        with self._lock:
            return None if identity not in self._replies else self._replies[identity][0]

    def keep(self, identity: Hashable | None, reply: Reply) -> None:
        """Remember the answer to this request."""
        if identity is None:
            return
        size = _size(reply)
        if size > self._largest_bytes:
            return
        with self._lock:
            self._bytes += size - self._replies.pop(identity, (reply, 0))[1]
            self._replies[identity] = reply, size
            while len(self._replies) > LARGEST or self._bytes > self._largest_bytes:
                self._bytes -= self._replies.popitem(last=False)[1][1]


def _size(value: object) -> int:
    """Return about how many bytes a value takes in memory."""
    if isinstance(value, bytes | str):
        return 64 + len(value)
    if isinstance(value, BaseModel):
        return 64 + sum(_size(part) for _, part in value)
    if isinstance(value, dict):
        return 64 + sum(_size(key) + _size(part) for key, part in value.items())
    if isinstance(value, tuple):
        return 64 + sum(map(_size, value))
    return 32
