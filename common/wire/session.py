"""Zenoh sessions: clients of a router, without multicast."""

import json
import logging
import os
import signal
import threading
import time

import zenoh

from common.domain.errors import CancelledError, RequestError, UnavailableError
from common.wire.settings import WireSettings

Session = zenoh.Session
log = logging.getLogger(__name__)

ATTEMPT_MS = 500


def open_session(
    settings: WireSettings, *, wait_s: float | None = 2.0, stop: threading.Event | None = None
) -> zenoh.Session:
    """Open a client session, waiting for the router to appear.

    Args:
        settings: Where the router is.
        wait_s: How long to wait for it; None means until it comes [s].
        stop: Ends the waiting when set.

    Raises:
        UnavailableError: There was no router in time.
        CancelledError: ``stop`` was set.
        RequestError: An endpoint or the configuration file is wrong.
    """
    config = configuration("client", settings)
    insert(config, "connect/endpoints", settings.connect)
    insert(config, "connect/timeout_ms", ATTEMPT_MS)
    insert(config, "connect/exit_on_failure", True)
    began, told = time.monotonic(), False
    while stop is None or not stop.is_set():
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if wait_s is not None and time.monotonic() - began >= wait_s - ATTEMPT_MS / 1000:
                where = ", ".join(settings.connect)
                raise UnavailableError(f"expected a Zenoh router at {where}, got: {str(error)[:160]}") from None
            if not told:
                log.warning("waiting for a Zenoh router at %s", ", ".join(settings.connect))
                told = True
            time.sleep(0.05)
    raise CancelledError("stopped while waiting for a Zenoh router")


def open_router(settings: WireSettings) -> zenoh.Session:
    """Open a session that routes between all clients.

    Raises:
        UnavailableError: An endpoint cannot be listened on.
    """
    config = configuration("router", settings)
    insert(config, "listen/endpoints", settings.listen)
    insert(config, "listen/exit_on_failure", True)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        where = ", ".join(settings.listen)
        raise UnavailableError(f"expected to listen on {where}, got: {str(error)[:160]}") from None


def is_connected(session: zenoh.Session) -> bool:
    """Return whether a client session has a router now."""
    return not session.is_closed() and bool(session.info.routers_zid())


def configuration(mode: str, settings: WireSettings) -> zenoh.Config:
    """Return the Zenoh configuration that all sessions share."""
    try:
        config = zenoh.Config() if settings.zenoh_config is None else zenoh.Config.from_file(settings.zenoh_config)
    except zenoh.ZError as error:
        raise RequestError(
            f"expected a Zenoh configuration in {settings.zenoh_config}, got: {str(error)[:160]}"
        ) from None
    insert(config, "mode", mode)
    insert(config, "scouting/multicast/enabled", False)
    insert(config, "scouting/gossip/enabled", False)
    insert(config, "timestamping/enabled", True)
    insert(config, "transport/link/tx/lease", round(settings.lease_s * 1000))
    insert(config, "transport/shared_memory/enabled", settings.shared_memory)
    return config


def insert(config: zenoh.Config, key: str, value: object) -> None:
    """Set one key of a Zenoh configuration.

    Raises:
        RequestError: Zenoh does not take that value there.
    """
    try:
        config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise RequestError(f"{key}: expected a value that Zenoh takes, got {value!r} ({str(error)[:120]})") from None


def stop_on_signals() -> threading.Event:
    """Return an event that SIGTERM and SIGINT set. Call it in the main thread.

    A thread of its own sets it: Python's handlers run in the main thread, where one can come too late to end a wait
    that is about to begin, or find the event's lock taken.
    """
    stop = threading.Event()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    numbers = (signal.SIGTERM, signal.SIGINT)

    def set_stop() -> None:
        while os.read(reader, 1)[0] not in numbers:
            pass
        stop.set()

    threading.Thread(target=set_stop, name="signals", daemon=True).start()
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in numbers:
        signal.signal(number, lambda *_: None)
    return stop
