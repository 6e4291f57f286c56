"""The last answers of a worker, so that a retry of the same request is not computed twice."""

import threading
from collections import OrderedDict
from collections.abc import Hashable

from common.wire.messages import Reply

LARGEST = 32


class ReplyCache:
    """Answers by the identity of their request, the oldest forgotten first. Safe to use from several threads."""

    def __init__(self) -> None:
        self._replies: OrderedDict[Hashable, Reply] = OrderedDict()
        self._lock = threading.Lock()

    def find(self, identity: Hashable | None) -> Reply | None:
        """Return the answer that was given to this request, None if there was none."""
        with self._lock:
            return None if identity is None else self._replies.get(identity)

    def keep(self, identity: Hashable | None, reply: Reply) -> None:
        """Remember the answer to this request."""
        if identity is None:
            return
        with self._lock:
            self._replies[identity] = reply
            while len(self._replies) > LARGEST:
                self._replies.popitem(last=False)
