"""Messages to bytes and back: MessagePack, or JSON for people and plain clients."""

from typing import Literal, TypeVar

import msgpack
from pydantic import BaseModel, ValidationError
from pydantic_core import from_json

from common.domain.errors import RequestError

Format = Literal["msgpack", "json"]
Message = TypeVar("Message", bound=BaseModel)

MAX_REQUEST_BYTES = 64 * 2**20
MAX_REPLY_BYTES = 256 * 2**20


def encode(message: BaseModel, *, form: Format = "msgpack") -> tuple[bytes, str]:
    """Return a message's payload and its encoding, ``application/msgpack;<Message>`` or ``application/json``."""
    if form == "json":
        return message.model_dump_json().encode(), "application/json"
    payload = msgpack.packb(message.model_dump(), use_bin_type=True)
    return payload or b"", f"application/msgpack;{type(message).__name__}"


def form_of(payload: bytes, encoding: str) -> Format:
    """Return the format of a payload: by its encoding, or by its first byte where that says nothing."""
    media = encoding.partition(";")[0]
    if media in ("application/json", "text/json"):
        return "json"
    if media == "application/msgpack":
        return "msgpack"
    return "json" if payload.lstrip()[:1] == b"{" else "msgpack"


def decode(payload: bytes, encoding: str, message: type[Message]) -> Message:
    """Return the message in a payload.

    Raises:
        RequestError: The payload is not of that format, or not that message; the text says what was expected and got.
    """
    media, _, schema = encoding.partition(";")
    if media == "application/msgpack" and schema not in ("", message.__name__):
        raise RequestError(f"expected application/msgpack;{message.__name__}, got {encoding[:200]}")
    form = form_of(payload, encoding)
    try:
        if form == "json":
            raw = from_json(payload, allow_inf_nan=False)
        else:
            raw = msgpack.unpackb(payload, raw=False, max_array_len=10_000, max_map_len=10_000)
    except (ValueError, msgpack.UnpackException) as error:
        name = "JSON" if form == "json" else "MessagePack"
        reason = f"{type(error).__name__} {error}"[:120]
        raise RequestError(
            f"expected {message.__name__} as {name}, got {len(payload)} other bytes ({reason})"
        ) from None
    if not isinstance(raw, dict):
        raise RequestError(f"expected {message.__name__} as a map, got {_describe(raw)}")
    try:
        return message.model_validate(raw)
    except ValidationError as error:
        raise RequestError(f"{message.__name__}: {_explain(error)}") from None


def _explain(error: ValidationError) -> str:
    found = error.errors(include_url=False, include_context=False)
    lines: list[str] = []
    for one in found[:3]:
        where = ".".join(str(part) for part in one["loc"])
        text = one["msg"].removeprefix("Value error, ").replace("Input should be", "expected")
        got = (
            "" if "got" in text or one["type"] in ("missing", "extra_forbidden") else f", got {_describe(one['input'])}"
        )
        lines.append(f"{where}: {text}{got}" if where else text + got)
    if len(found) > 3:
        lines.append(f"and {len(found) - 3} more")
    return "; ".join(lines)


def _describe(value: object) -> str:
    if isinstance(value, bytes | list | dict):
        return f"{type(value).__name__} of {len(value)}"
    if isinstance(value, str) and len(value) > 40:
        return f"text of {len(value)} characters"
    return repr(value)[:40]
