import base64
import hashlib
import json
import struct
from pathlib import Path

import numpy as np
import pytest

from common.planning.optimize import optimize
from common.planning.problem import Problem
from common.tasks import TASKS
from common.wire.codec import decode
from common.wire.optimization import OptimizeRequest
from common.wire.schemas import FOLDER, MESSAGES, REFRESH, schemas
from common.wire.state import StateMessage
from services.heuristic import HeuristicModel

EXAMPLES = sorted((FOLDER / "examples").glob("*.*"))


@pytest.mark.parametrize("name", [f"{name}.json" for name in MESSAGES])
def test_the_committed_schema_is_current(name: str):
    path = FOLDER / name
    committed = path.read_text() if path.exists() else ""
    assert json.loads(committed or "null") == json.loads(schemas()[name]), f"{name} is not current; run: {REFRESH}"


def test_there_is_no_schema_of_a_message_that_is_gone():
    stale = {path.name for path in FOLDER.glob("*.json")} - set(schemas())
    assert not stale, f"{stale} have no message; run: {REFRESH}"


def test_every_message_has_a_recorded_example():
    recorded = {path.stem for path in EXAMPLES}
    assert recorded >= set(MESSAGES), f"run: {REFRESH} --record"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_a_recorded_message_still_decodes(path: Path):
    message = decode(path.read_bytes(), "", MESSAGES[path.stem])
    assert type(message) is MESSAGES[path.stem]


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_is_the_same_in_both_formats(name: str):
    packed = (FOLDER / "examples" / f"{name}.msgpack").read_bytes()
    text = (FOLDER / "examples" / f"{name}.json").read_bytes()
    assert decode(packed, "application/msgpack", MESSAGES[name]) == decode(text, "application/json", MESSAGES[name])


def test_the_digest_is_what_the_documentation_says():
    request = json.loads((FOLDER / "examples" / "PredictRequest.json").read_text())
    grid, scene, item = (request["content"][part] for part in ("grid", "scene", "item"))
    arrays = (scene["heights"], scene["materials"], item["heights"], item["materials"])
    plate, boxes = scene["bodies"]["plate"], scene["bodies"]["boxes"]
    numbers = [*plate["radii"], *plate["heights"]]
    for box in boxes:
        numbers += [*box["size"], *box["position"], *box["orientation"]]
        numbers += [box["density"], box["youngs_modulus"], box["poisson_ratio"]]
    data = struct.pack("<qqd", grid["rows"], grid["columns"], grid["cell"])
    data += b"".join(base64.b64decode(array["data"]) for array in arrays)
    data += b"\x01" + struct.pack(f"<{len(numbers)}d", *numbers)
    assert hashlib.sha256(data).hexdigest() == request["state"]
    assert StateMessage.model_validate(request["content"]).state().digest == request["state"]


def test_the_recorded_optimisation_can_be_served():
    request = decode((FOLDER / "examples" / "OptimizeRequest.json").read_bytes(), "", OptimizeRequest)
    bounds = None if request.bounds is None else np.array(request.bounds)
    problem = Problem(TASKS[request.task], request.state.state(), request.target.values(), bounds)
    models = {"heuristic": HeuristicModel()}
    result = optimize(
        problem, models, {}, strategy=request.strategy, evaluations=request.evaluations, seed=request.seed
    )
    np.testing.assert_allclose(result.action, (0.01, -0.01), atol=2e-3)
