"""The states that a worker holds, by content."""

import threading
from collections import OrderedDict

from common.domain.errors import RequestError, UnknownStateError
from common.domain.scene import State
from common.wire.state import StateMessage


class StateCache:
    """States by digest, the least recently used forgotten first. Safe to use from several threads.

    The same digest gives the same object, so that a model can keep what it derives from a state with it.
    """

    def __init__(self, *, largest_count: int = 64, largest_bytes: int = 256 * 2**20) -> None:
        self._states: OrderedDict[str, State] = OrderedDict()
        self._largest_count = largest_count
        self._largest_bytes = largest_bytes
        self._bytes = 0
        self._lock = threading.Lock()

    def resolve(self, digest: str | None, content: StateMessage | None) -> State:
        """Return the state that a request names or carries, and keep it.

        Raises:
            UnknownStateError: It is named and neither held nor carried.
            RequestError: What is carried is no state, or not the one that is named.
        """
        with self._lock:
            if digest is not None and digest in self._states:
                self._states.move_to_end(digest)
                return self._states[digest]
        if content is None:
            raise UnknownStateError(f"state: expected one that this worker holds, got {digest}; send it as 'content'")
        state = content.state()
        if digest is not None and digest != state.digest:
            raise RequestError(f"state: expected the digest of 'content', {state.digest}, got {digest}")
        return self._keep(state)

    def _keep(self, state: State) -> State:
        with self._lock:
            known = self._states.setdefault(state.digest, state)
            self._states.move_to_end(state.digest)
            if known is state:
                self._bytes += _size(state)
            while len(self._states) > 1 and (
                len(self._states) > self._largest_count or self._bytes > self._largest_bytes
            ):
                self._bytes -= _size(self._states.popitem(last=False)[1])
            return known


def _size(state: State) -> int:
    arrays = (state.scene.heights, state.scene.materials, state.item.heights, state.item.materials)
    return sum(array.nbytes for array in arrays)
