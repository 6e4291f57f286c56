"""Settings of a process on the network, from ``FRUGAL_...`` environment variables."""

from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

Endpoints = Annotated[tuple[str, ...], NoDecode, Field(min_length=1)]


class WireSettings(BaseSettings):
    """How a process reaches the others.

    Attributes:
        connect: Endpoints of the router, separated by commas in the environment (``FRUGAL_CONNECT``).
        listen: Endpoints that a router opens (``FRUGAL_LISTEN``).
        zenoh_config: A Zenoh configuration file to start from, for TLS and access control for instance.
        lease_s: A silent connection is given up after this time [s].
        shared_memory: Whether large messages go through shared memory, where all hops allow it.
        grace_s: Time that a computation in progress gets when its process has to stop [s].
    """

    model_config = SettingsConfigDict(env_prefix="FRUGAL_", frozen=True, extra="forbid")

    connect: Endpoints = ("tcp/127.0.0.1:7447",)
    listen: Endpoints = ("tcp/127.0.0.1:7447",)
    zenoh_config: Path | None = None
    lease_s: Annotated[float, Field(ge=0.5, le=60)] = 5.0
    shared_memory: bool = False
    grace_s: Annotated[float, Field(ge=0, le=600)] = 5.0

    @field_validator("connect", "listen", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(part.strip() for part in value.split(",") if part.strip())
        return value
