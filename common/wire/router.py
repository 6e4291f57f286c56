"""The router as a process of its own: every other process is its client."""

import logging
import threading

from common.wire.session import open_router, stop_on_signals
from common.wire.settings import WireSettings

log = logging.getLogger(__name__)


def run_router(settings: WireSettings, *, stop: threading.Event | None = None) -> int:
    """Route until SIGTERM, SIGINT or ``stop``, and return the process's exit code.

    Raises:
        UnavailableError: An endpoint cannot be listened on.
    """
    stop = stop or stop_on_signals()
    session = open_router(settings)
    log.info("routing on %s", ", ".join(settings.listen))
    stop.wait()
    session.close()
    return 0
