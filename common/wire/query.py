"""One question to one key, and what its silence means."""

import queue
import time
from collections.abc import Callable

import zenoh
from pydantic import BaseModel

from common.domain.errors import CancelledError, FrugalError, ModelError, RequestError, TimedOutError, UnavailableError
from common.wire.codec import MAX_REPLY_BYTES, Message, decode, encode
from common.wire.messages import ErrorReply

POLL_S = 0.05


class NoReplyError(UnavailableError):
    """A query ended without any reply: nobody serves the key, its server died, or access was denied."""


def never() -> bool:
    """Return False: the question is not taken back."""
    return False


def ask(
    session: zenoh.Session,
    key: str,
    request: BaseModel | None,
    reply: type[Message],
    *,
    timeout_s: float,
    cancelled: Callable[[], bool] = never,
) -> Message:
    """Send a request to a key and return the one reply.

    The remaining budget, ``timeout_s``, travels as the attachment, so that nobody computes for a caller who is gone.

    Raises:
        NoReplyError: The query ended without a reply.
        TimedOutError: No reply came in time.
        CancelledError: ``cancelled`` returned True while waiting.
        ModelError: The reply is not the message that was expected.
        FrugalError: What the worker answered instead, by its code.
    """
    payload, encoding = (None, None) if request is None else encode(request)
    replies: queue.SimpleQueue[zenoh.Reply | None] = queue.SimpleQueue()
    token = zenoh.CancellationToken()
    deadline = time.monotonic() + timeout_s
    try:
        session.get(
            key,
            zenoh.handlers.Callback(replies.put, lambda: replies.put(None), indirect=False),
            payload=payload,
            encoding=encoding,
            attachment=f"{timeout_s:.6f}",
            timeout=timeout_s + 1.0,
            consolidation=zenoh.ConsolidationMode.NONE,
            cancellation_token=token,
        )
    except zenoh.ZError as error:
        raise NoReplyError(f"no reply from {key}: {str(error)[:160]}") from None
    while True:
        left = deadline - time.monotonic()
        try:
            found = replies.get(timeout=max(0.0, min(POLL_S, left)))
        except queue.Empty:
            if cancelled():
                token.cancel()
                raise CancelledError(f"{key}: the request was taken back") from None
            if left <= 0:
                token.cancel()
                raise TimedOutError(f"{key}: expected a reply within {timeout_s:.3g} s, got none") from None
            continue
        if found is None:
            raise NoReplyError(f"no reply from {key}: nobody serves it, or its process stopped")
        return _read(found, key, reply, timeout_s)


def _read(found: zenoh.Reply, key: str, reply: type[Message], timeout_s: float) -> Message:
    if found.err is not None:
        raise _error(found.err, key, timeout_s)
    sample = found.ok
    size = 0 if sample is None else len(sample.payload)
    if sample is None or size > MAX_REPLY_BYTES:
        raise ModelError(f"{key}: expected a reply of at most {MAX_REPLY_BYTES} bytes, got {size}")
    try:
        return decode(sample.payload.to_bytes(), str(sample.encoding), reply)
    except RequestError as error:
        raise ModelError(f"{key}: {error}") from None


def _error(found: zenoh.ReplyError, key: str, timeout_s: float) -> FrugalError:
    encoding, payload = str(found.encoding), found.payload.to_bytes()
    if encoding == "zenoh/string" and payload == b"Timeout":
        return TimedOutError(f"{key}: expected a reply within {timeout_s:.3g} s, got none")
    try:
        return decode(payload, encoding, ErrorReply).error()
    except RequestError as error:
        return ModelError(f"{key}: expected an error reply that can be read, got: {error}")
