"""The life of a worker process: connect, serve, leave cleanly when told to."""

import logging
import os
import sys
import threading
from collections.abc import Callable

import zenoh

from common.domain.errors import CancelledError
from common.wire.host import Host
from common.wire.session import open_session, stop_on_signals
from common.wire.settings import WireSettings

log = logging.getLogger(__name__)


def run_host(
    build: Callable[[zenoh.Session], Host], settings: WireSettings, *, stop: threading.Event | None = None
) -> int:
    """Serve until SIGTERM, SIGINT or ``stop``, and return the process's exit code.

    Waits for the router as long as it takes. Computations get ``settings.grace_s`` to end; a process with one that
    does not end by then is ended all the same.

    Args:
        build: Makes the host on an open session; what takes long (weights, kernels) belongs before this call.
        settings: Where the router is.
        stop: Ends the process when set, instead of the signals.
    """
    stop = stop or stop_on_signals()
    log.info("settings: %s", settings.model_dump_json())
    try:
        session = open_session(settings, wait_s=None, stop=stop)
    except CancelledError:
        return 0
    with session:
        host = build(session)
        host.start()
        stop.wait()
        is_done = host.stop(grace_s=settings.grace_s)
    if not is_done:
        log.warning("a computation did not end within %g s and was abandoned", settings.grace_s)
        logging.shutdown()
        sys.stdout.flush()
        os._exit(0)
    return 0
