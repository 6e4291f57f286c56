"""What computations cost, measured: moving medians by batch size."""

import threading
from collections import deque
from statistics import median

from common.wire.messages import Cost

WINDOW = 32
LARGEST_TABLE = 256


class CostMeter:
    """Keep the last computations' times of each batch size. Safe to use from several threads."""

    def __init__(self) -> None:
        self._times: dict[int, deque[float]] = {}
        self._lock = threading.Lock()

    def record(self, batch: int, seconds: float) -> None:
        """Add one computation of ``batch`` actions that took ``seconds`` [s]."""
        with self._lock:
            if batch not in self._times and len(self._times) >= LARGEST_TABLE:
                return
            self._times.setdefault(batch, deque(maxlen=WINDOW)).append(seconds)

    def costs(self) -> tuple[Cost, ...]:
        """Return the medians, by increasing batch size."""
        with self._lock:
            return tuple(
                Cost(batch=batch, p50_s=median(times), count=len(times)) for batch, times in sorted(self._times.items())
            )

    def median_s(self, batch: int) -> float | None:
        """Return the median for one batch size [s], None if there was none yet."""
        with self._lock:
            times = self._times.get(batch)
            return median(times) if times else None
