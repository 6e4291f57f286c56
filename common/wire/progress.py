"""Progress that late subscribers can replay: one publisher with a cache for each request."""

import threading
from collections import OrderedDict

import zenoh
import zenoh.ext

from common.wire.codec import encode
from common.wire.keys import Address
from common.wire.optimization import Progress

STEPS_KEPT = 8192
REQUESTS_KEPT = 32


class ProgressBoard:
    """Publishers on ``progress/<id>``; the steps of the last `REQUESTS_KEPT` ended requests stay readable."""

    def __init__(self, session: zenoh.Session, address: Address) -> None:
        self._session = session
        self._address = address
        self._running: dict[str, zenoh.ext.AdvancedPublisher] = {}
        self._ended: OrderedDict[str, zenoh.ext.AdvancedPublisher] = OrderedDict()
        self._lock = threading.Lock()

    def publish(self, progress: Progress) -> None:
        """Publish one step of the request that it names."""
        with self._lock:
            publisher = self._running.get(progress.id) or self._open(progress.id)
        payload, encoding = encode(progress)
        publisher.put(payload, encoding=encoding)

    def end(self, request_id: str) -> None:
        """Note that a request has ended, and forget the one that ended first if there are too many."""
        with self._lock:
            publisher = self._running.pop(request_id, None)
            if publisher is None:
                return
            self._ended[request_id] = publisher
            if len(self._ended) > REQUESTS_KEPT:
                self._ended.popitem(last=False)[1].undeclare()

    def close(self) -> None:
        """Undeclare every publisher."""
        with self._lock:
            for publisher in (*self._running.values(), *self._ended.values()):
                publisher.undeclare()
            self._running.clear()
            self._ended.clear()

    def _open(self, request_id: str) -> zenoh.ext.AdvancedPublisher:
        earlier = self._ended.pop(request_id, None)
        if earlier is not None:
            earlier.undeclare()
        publisher = zenoh.ext.declare_advanced_publisher(
            self._session,
            self._address.key(f"progress/{request_id}"),
            congestion_control=zenoh.CongestionControl.BLOCK,
            cache=zenoh.ext.CacheConfig(STEPS_KEPT),
            publisher_detection=True,
        )
        self._running[request_id] = publisher
        return publisher
