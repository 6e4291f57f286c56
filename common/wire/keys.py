"""The keys of the protocol: who is where, and which of its endpoints a key names."""

import re
from dataclasses import dataclass
from typing import Literal, get_args

from common.domain.errors import RequestError

VERSION = 1
ROOT = f"frugal/@v{VERSION}"
TRIAL = "trial"
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"

Role = Literal["model", "mde", "orchestrator", "recorder", "world"]
ROLES: tuple[Role, ...] = get_args(Role)
MODEL_ROLES: tuple[Role, ...] = ("model", "mde")
"""Roles whose workers are named after a model; the others have none in their keys."""


def check_name(kind: str, name: str) -> str:
    """Return ``name`` if it can be one chunk of a key, or raise `RequestError`."""
    if not re.match(NAME_PATTERN, name) or name.endswith("\n"):
        raise RequestError(
            f"{kind}: expected 1 to 64 letters, digits, '_', '.' or '-', the first a letter or digit, got {name[:80]!r}"
        )
    return name


@dataclass(frozen=True)
class Address:
    """One worker process: ``<task>/model/<model>/<instance>`` or, without a model, ``<task>/<role>/<instance>``.

    Attributes:
        task: The task that it serves.
        role: What it does.
        model: The model that it runs, or whose deviation it estimates; None for every other role.
        instance: Which of the processes of one kind it is.
    """

    task: str
    role: Role
    model: str | None
    instance: str

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise RequestError(f"role: expected one of {', '.join(ROLES)}, got {self.role!r}")
        if (self.role in MODEL_ROLES) != (self.model is not None):
            expected = "a name" if self.role in MODEL_ROLES else "none"
            raise RequestError(f"model: expected {expected} for the role {self.role}, got {self.model!r}")
        check_name("task", self.task)
        check_name("instance", self.instance)
        if self.model is not None:
            check_name("model", self.model)

    @property
    def prefix(self) -> str:
        """The key that all its endpoints start with."""
        return "/".join(part for part in (ROOT, self.task, self.role, self.model, self.instance) if part)

    @property
    def worker(self) -> str:
        """Its short name in events: ``<model>/<instance>``, ``mde/<model>/<instance>``, else ``<role>/<instance>``."""
        parts = (self.model,) if self.role == "model" else (self.role, self.model)
        return "/".join(part for part in (*parts, self.instance) if part)

    def key(self, leaf: str) -> str:
        """Return the key of an endpoint, ``predict`` or ``cancel/<id>`` for instance."""
        return f"{self.prefix}/{leaf}"


def parse_address(key: str) -> tuple[Address, str]:
    """Return the worker that a key belongs to, and the rest of the key (``live``, ``progress/<id>``).

    Raises:
        RequestError: It is no key of a worker.
    """
    if not key.startswith(f"{ROOT}/"):
        raise RequestError(f"expected a key under {ROOT}, got {key[:200]!r}")
    task, *rest = key.removeprefix(f"{ROOT}/").split("/")
    for role in ROLES:
        names = 2 if role in MODEL_ROLES else 1
        if rest[:1] == [role] and len(rest) >= names + 2:
            model = rest[1] if names == 2 else None
            return Address(task, role, model, rest[names]), "/".join(rest[names + 1 :])
    raise RequestError(f"expected a worker's key, got {key[:200]!r}")


def alias(task: str, leaf: str) -> str:
    """Return the key that reaches any worker that serves it for a task (``*``: every task), ``.../<task>/optimize``."""
    return f"{ROOT}/{task if task == '*' else check_name('task', task)}/{leaf}"


def trial_key(task: str, robot: str) -> str:
    """Return the key on which a robot reports its trials, ``.../<task>/trial/<robot>``."""
    return alias(task, f"{TRIAL}/{check_name('robot', robot)}")


def robot_of(key: str) -> str | None:
    """Return whose trials are reported on a key, None if it is no key of `trial_key`.

    Raises:
        RequestError: It is one, but its last chunk is no name.
    """
    parts = key.removeprefix(f"{ROOT}/").split("/")
    return check_name("robot", parts[2]) if len(parts) == 3 and parts[1] == TRIAL else None


def every_live(task: str) -> str:
    """Return the key expression of all liveliness tokens of a task (``*``: of every task)."""
    return every_worker(task, "live")


def every_worker(task: str, leaf: str) -> str:
    """Return the key expression of one endpoint at all workers of a task (``*``: of every task)."""
    return f"{ROOT}/{task}/**/{leaf}"


def every_orchestrator(task: str, leaf: str) -> str:
    """Return the key expression of one endpoint at all orchestrators of a task (``*``: of every task)."""
    return f"{ROOT}/{task}/orchestrator/*/{leaf}"
