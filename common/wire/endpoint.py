"""What a worker answers: a table of endpoints."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

from common.wire.call import Call
from common.wire.messages import Reply, Request


def unchanged(request: Request) -> Request:
    """Return the request as it is."""
    return request


def anonymous(request: Request) -> None:
    """Return None: the answer is not kept for retries."""
    del request


def keyless(request: Request, key: str) -> Request:
    """Return the request as it is: the key says nothing that it does not."""
    del key
    return request


@dataclass(frozen=True)
class Alias:
    """Another key that an endpoint answers on, shared with other workers.

    Attributes:
        key: The key, or a key expression that stands for one at every task or for every name in its last chunk.
        complete: Whether every worker that declares it can answer all that comes on it. What comes on one that is not
            complete, and on none of the complete ones, is refused with the task that this worker serves.
    """

    key: str
    complete: bool = True

    def answer_key(self, asked: str) -> str | None:
        """Return the key to answer on what came on ``asked``.

        None: both are expressions, ``**/card`` and ``trial/*`` for instance, so that it was not meant for this one.
        """
        if "*" not in self.key:
            return self.key
        return None if "*" in asked else asked


@dataclass(frozen=True)
class Endpoint:
    """One kind of request and how to answer it.

    Attributes:
        leaf: Last part of its key, ``predict`` for instance.
        request: The message that it takes.
        handler: Computes the reply from what ``prepare`` returned. Domain errors that it raises are sent to the caller
            as they are, anything else as the model's fault.
        prepare: Turns the request into what the handler takes, before the queue, so that its errors are told at once.
            It has to be quick.
        identity: What makes two requests the same, so that a retry gets the first answer again; None: always compute.
        aliases: Other keys that it answers on.
        unique_ids: Whether an id that is still in progress is refused.
        read_key: Takes over into the request what the key that it came on says.
        takes_puts: Whether what is put on its complete aliases counts as a request too; its errors are logged.
        exact: Whether a query has to name its very key: access control that denies the key lets wildcards pass.
        apart: Whether it is computed on a thread of its own, so that neither waits for the other endpoints' requests.
    """

    leaf: str
    request: type[Request]
    handler: Callable[[Any, Call], Reply]
    prepare: Callable[[Any], Any] = unchanged
    identity: Callable[[Any], Hashable | None] = anonymous
    aliases: tuple[Alias, ...] = ()
    unique_ids: bool = False
    read_key: Callable[[Any, str], Any] = keyless
    takes_puts: bool = False
    exact: bool = False
    apart: bool = False
