"""The public contract as files: JSON Schemas of all messages, and recorded examples.

``python -m common.wire.schemas`` rewrites the schemas. ``--record`` also records examples of messages that have none
yet; those that exist are never rewritten, because old messages have to stay readable.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel

from common.wire.codec import encode
from common.wire.examples import example_messages
from common.wire.messages import (
    CancelReply,
    Card,
    ErrorReply,
    EstimateReply,
    EstimateRequest,
    Health,
    LoadReply,
    LoadRequest,
    PredictReply,
    PredictRequest,
)
from common.wire.optimization import OptimizeReply, OptimizeRequest, Progress
from common.wire.report import TrialReply, TrialReport
from common.wire.world import ExecuteReply, ExecuteRequest, LookReply, LookRequest

FOLDER = Path(__file__).parents[2] / "proto_schemas"
REFRESH = "python -m common.wire.schemas"
MESSAGES: Mapping[str, type[BaseModel]] = {
    message.__name__: message
    for message in (
        PredictRequest,
        PredictReply,
        EstimateRequest,
        EstimateReply,
        LoadRequest,
        LoadReply,
        OptimizeRequest,
        OptimizeReply,
        Progress,
        TrialReport,
        TrialReply,
        LookRequest,
        LookReply,
        ExecuteRequest,
        ExecuteReply,
        Card,
        Health,
        CancelReply,
        ErrorReply,
    )
}
"""Name in the encoding -> message, for all that travel as a payload of their own."""


def schemas() -> dict[str, str]:
    """Return the text of every schema file by its name."""
    return {
        f"{name}.json": json.dumps(message.model_json_schema(), indent=2, sort_keys=True) + "\n"
        for name, message in MESSAGES.items()
    }


def write_schemas(folder: Path) -> None:
    """Write every schema, and remove those of messages that are gone."""
    texts = schemas()
    for path in folder.glob("*.json"):
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        (folder / name).write_text(text)


def record_examples(folder: Path) -> None:
    """Write one example of every message that has none, as MessagePack and as JSON."""
    folder.mkdir(exist_ok=True)
    for message in example_messages():
        path = folder / f"{type(message).__name__}.msgpack"
        if not path.exists():
            path.write_bytes(encode(message)[0])
            path.with_suffix(".json").write_bytes(encode(message, form="json")[0] + b"\n")


if __name__ == "__main__":
    write_schemas(FOLDER)
    if "--record" in sys.argv[1:]:
        record_examples(FOLDER / "examples")
