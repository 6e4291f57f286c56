"""One query that waits for its answer: read it, answer it once. What was put is read alike and gets no answer."""

import logging
import math
import threading
from collections.abc import Callable, Hashable

import zenoh
from pydantic import BaseModel

from common.domain.errors import RequestError
from common.wire.codec import MAX_REQUEST_BYTES, Format, Message, decode, encode, form_of
from common.wire.messages import Reply

log = logging.getLogger(__name__)


class Job:
    """A query or a put, and once it has been admitted, its computation.

    Attributes:
        key: The concrete key to answer on, or of the put.
        asked: The key, or the key expression, that was asked.
        form: Format of the request, and therefore of the answer.
        compute: Computes the reply.
        identity: What makes another request the same one.
        begun: When the computation began, on the monotonic clock [s]; None while it waits.
        followers: The same request asked again meanwhile; they get the same answer.
    """

    def __init__(self, asked: zenoh.Query | zenoh.Sample, key: str) -> None:
        self.key = key
        self.asked = str(asked.key_expr)
        self.form: Format = "json" if asked.payload is None else "msgpack"
        self.compute: Callable[[], Reply] | None = None
        self.identity: Hashable | None = None
        self.begun: float | None = None
        self.followers: list[Job] = []
        self._asked = asked
        self._is_claimed = False
        self._lock = threading.Lock()

    def read(self, message: type[Message]) -> Message:
        """Return the request in the query's payload.

        Raises:
            RequestError: There is none, it is too large, or it is not that message.
        """
        payload, encoding = self._asked.payload, str(self._asked.encoding or "")
        if payload is None or len(payload) == 0:
            raise RequestError(f"expected {message.__name__} as the payload, got none")
        if len(payload) > MAX_REQUEST_BYTES:
            raise RequestError(f"expected a payload of at most {MAX_REQUEST_BYTES} bytes, got {len(payload)}")
        data = payload.to_bytes()
        self.form = form_of(data, encoding)
        return decode(data, encoding, message)

    def budget_s(self) -> float:
        """Return the caller's remaining time from the attachment, infinite without one [s].

        Raises:
            RequestError: The attachment is not a number as text.
        """
        attachment = self._asked.attachment
        if attachment is None or len(attachment) == 0:
            return math.inf
        data = attachment.to_bytes()[:40]
        try:
            budget_s = float(data)
        except ValueError:
            budget_s = math.nan
        if math.isnan(budget_s):
            raise RequestError(f"attachment: expected the remaining budget in seconds as text, got {data!r}")
        return budget_s

    def claim(self) -> bool:
        """Return True to the first caller, who has to answer, and False to all others."""
        with self._lock:
            is_first, self._is_claimed = not self._is_claimed, True
            return is_first

    def answer(self, reply: BaseModel, *, is_error: bool = False) -> None:
        """Send a message, in the format of the request, and let go of the query."""
        self.answer_bytes(*self.encode(reply), is_error=is_error)

    def encode(self, reply: BaseModel) -> tuple[bytes, str]:
        """Return a message's payload and encoding, in the format of the request; for the log, text."""
        return encode(reply, form="json" if isinstance(self._asked, zenoh.Sample) else self.form)

    def answer_bytes(self, payload: bytes, encoding: str, *, is_error: bool = False) -> None:
        """Send a payload and let go of the query; of a put only the error is of interest, and goes into the log."""
        if isinstance(self._asked, zenoh.Sample):
            if is_error:
                log.warning("%s: refused what was put: %s", self.key, payload.decode())
            return
        try:
            with self._asked as query:
                if is_error:
                    query.reply_err(payload, encoding=encoding)
                else:
                    query.reply(self.key, payload, encoding=encoding)
        except zenoh.ZError as error:
            log.warning("%s: the answer could not be sent: %s", self.key, error)
