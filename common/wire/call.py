"""One request on its way through a worker."""

import math
import threading
import time
from collections.abc import Callable

from common.wire.messages import new_id
from common.wire.optimization import Progress


class Call:
    """What a handler may know and do about the request that it answers.

    Attributes:
        id: The request's identifier.
        began: When it arrived, on the monotonic clock [s].
    """

    def __init__(
        self,
        request_id: str,
        *,
        budget_s: float,
        waiting: Callable[[], int],
        publish: Callable[[Progress], None],
    ) -> None:
        self.id = request_id
        self.began = time.monotonic()
        self._deadline = self.began + budget_s
        self._run = new_id()
        self._taken_back = threading.Event()
        self._waiting = waiting
        self._publish = publish
        self._lock = threading.Lock()
        self._published = 0

    def remaining(self) -> float:
        """Return the caller's remaining budget, infinite if none was given [s]."""
        return self._deadline - time.monotonic() if math.isfinite(self._deadline) else math.inf

    def cancelled(self) -> bool:
        """Return whether the caller took the request back, or this process has to stop."""
        return self._taken_back.is_set()

    def cancel(self) -> None:
        """Take the request back."""
        self._taken_back.set()

    def waiting(self) -> int:
        """Return how many requests wait in this worker's queue."""
        return self._waiting()

    def publish(self, progress: Progress) -> None:
        """Publish a step on ``progress/<id>``, numbered in the order of calls; late subscribers get all of them."""
        with self._lock:
            self._publish(progress.model_copy(update={"id": self.id, "run": self._run, "index": self._published}))
            self._published += 1

    @property
    def has_published(self) -> bool:
        """Whether anything was published."""
        return self._published > 0
