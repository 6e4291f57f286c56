"""Does one process answer? For health checks, which run every few seconds: it needs Zenoh and nothing else heavy."""

import json
from collections.abc import Sequence

import zenoh

from common.domain.errors import RequestError, UnavailableError
from common.wire.keys import MODEL_ROLES, ROLES, ROOT, check_name

ATTEMPT_MS = 1000
ANSWER_S = 3.0


def health_key(name: str, *, instance: str) -> str:
    """Return the key expression of the health of a model's worker, of an MDE, or of a worker without a model.

    Args:
        name: A model, ``mde/<model>``, or a role without a model: ``orchestrator``, ``recorder``, ``world``.
        instance: A name or a key expression of one chunk, ``host-$*`` for instance.
    """
    kind, _, model = name.rpartition("/")
    if name in ROLES and name not in MODEL_ROLES:
        worker = name
    elif kind in ("", "mde"):
        worker = f"{kind or 'model'}/{check_name('name', model)}"
    else:
        raise RequestError(f"name: expected a model, mde/<model> or a role without one, got {name[:80]!r}")
    return f"{ROOT}/*/{worker}/{instance}/health"


def probe(key: str | None, *, connect: Sequence[str], zenoh_config: str | None = None) -> None:
    """Connect to the router, and get an answer from behind a key if there is one.

    Args:
        key: What to ask; None asks only for the router.
        connect: Endpoints of the router.
        zenoh_config: A Zenoh configuration file to start from.

    Raises:
        UnavailableError: The router, or the key's process, did not answer.
    """
    try:
        config = zenoh.Config.from_file(zenoh_config) if zenoh_config else zenoh.Config()
        for name, value in (
            ("mode", "client"),
            ("scouting/multicast/enabled", False),
            ("connect/endpoints", list(connect)),
            ("connect/timeout_ms", ATTEMPT_MS),
            ("connect/exit_on_failure", True),
        ):
            config.insert_json5(name, json.dumps(value))
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise UnavailableError(f"expected a router at {', '.join(connect)}, got: {str(error)[:160]}") from None
    with session:
        if key is not None and not any(reply.ok for reply in session.get(key, timeout=ANSWER_S)):
            raise UnavailableError(f"expected an answer from {key}, got none")
