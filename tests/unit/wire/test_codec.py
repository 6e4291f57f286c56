import json
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from common.domain.errors import RequestError
from common.wire.array import Array
from common.wire.codec import Format, decode, encode
from common.wire.examples import example_messages
from common.wire.messages import ErrorReply, PredictRequest
from common.wire.optimization import OptimizeRequest
from common.wire.state import StateMessage
from tests.fakes import make_state

PACKED = "application/msgpack;PredictRequest"


def fields(**changes: object) -> dict[str, object]:
    return {"id": "a", "state": "0" * 64, "actions": Array.of(np.zeros((1, 2))).model_dump(), **changes}


def optimize_fields(**changes: object) -> dict[str, object]:
    state = make_state()
    target = Array.of(state.scene.heights).model_dump()
    return {"state": StateMessage.of(state).model_dump(), "target": target, **changes}


@pytest.mark.parametrize("message", example_messages(), ids=lambda message: type(message).__name__)
@pytest.mark.parametrize("form", ["msgpack", "json"])
def test_every_message_comes_back_equal(message: BaseModel, form: Format):
    assert decode(*encode(message, form=form), type(message)) == message


def test_the_encoding_names_the_message():
    assert encode(ErrorReply(code="busy", message="x"))[1] == "application/msgpack;ErrorReply"
    assert encode(ErrorReply(code="busy", message="x"), form="json")[1] == "application/json"


@pytest.mark.parametrize("encoding", ["", "zenoh/bytes", "text/plain"])
@pytest.mark.parametrize("form", ["msgpack", "json"])
def test_a_payload_without_a_known_encoding_is_recognised_by_its_first_byte(encoding: str, form: Format):
    message = PredictRequest.model_validate(fields())
    assert decode(encode(message, form=form)[0], encoding, PredictRequest) == message


@given(st.binary(max_size=200))
def test_garbage_is_refused_in_one_short_line(payload: bytes):
    for encoding in ("", "application/msgpack", "application/json"):
        with pytest.raises(RequestError, match="PredictRequest") as caught:
            decode(payload, encoding, PredictRequest)
        assert len(str(caught.value)) < 400
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"actions": None}, "actions: "),
        ({"actions": [[0.0, 0.0]]}, "actions: "),
        ({"surprise": 1}, "surprise: Extra inputs are not permitted"),
        ({"state": "abc"}, "state: .* got 'abc'"),
        ({"id": "a/b"}, "id: .* got 'a/b'"),
        ({"id": 7}, "id: .* got 7"),
    ],
)
def test_a_wrong_field_is_named_with_what_came(changes: dict[str, object], said: str):
    with pytest.raises(RequestError, match=f"PredictRequest: {said}"):
        decode(msgpack.packb(fields(**changes)), PACKED, PredictRequest)


def test_a_missing_field_is_named():
    raw = fields()
    del raw["actions"]
    with pytest.raises(RequestError, match="PredictRequest: actions: Field required"):
        decode(msgpack.packb(raw), PACKED, PredictRequest)


def test_another_message_s_encoding_is_refused():
    with pytest.raises(RequestError, match="expected application/msgpack;ErrorReply, got application/msgpack;Predict"):
        decode(msgpack.packb({}), PACKED, ErrorReply)


@pytest.mark.parametrize("evaluations", [0, -1, 5001, 10**6, 2**70, 1.5, "many", None])
def test_a_number_of_evaluations_out_of_range_is_refused(evaluations: object):
    with pytest.raises(RequestError, match=r"OptimizeRequest: evaluations: expected .* got"):
        decode(json.dumps(jsonable(optimize_fields(evaluations=evaluations))).encode(), "", OptimizeRequest)


@pytest.mark.parametrize("bounds", [[[0.1, 0.1], [0, 1]], [[0.2, 0.1], [0, 1]]])
def test_empty_bounds_are_refused(bounds: object):
    with pytest.raises(RequestError, match="bounds: expected low < high for parameter 0, got"):
        decode(msgpack.packb(optimize_fields(bounds=bounds)), "", OptimizeRequest)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_number_that_is_not_finite_is_refused(value: float):
    with pytest.raises(RequestError, match="d_max: expected a finite number"):
        decode(msgpack.packb(optimize_fields(d_max=value)), "", OptimizeRequest)
    with pytest.raises(RequestError, match="as JSON"):
        decode(b'{"d_max": NaN}', "", OptimizeRequest)


def test_many_errors_are_cut_short():
    raw: dict[str, Any] = optimize_fields()
    raw["state"]["scene"]["bodies"] = {"boxes": [{"size": "x"}] * 1000}
    with pytest.raises(RequestError, match=r"and \d+ more") as caught:
        decode(msgpack.packb(raw), "", OptimizeRequest)
    assert len(str(caught.value)) < 600


def test_a_large_wrong_value_is_described_and_not_repeated():
    with pytest.raises(RequestError, match="got text of 1000000 characters"):
        decode(msgpack.packb(optimize_fields(evaluations="9x" * 500_000)), "", OptimizeRequest)


def jsonable(raw: dict[str, object]) -> object:
    request = OptimizeRequest.model_validate({**raw, "evaluations": 1})
    return {**request.model_dump(mode="json"), "evaluations": raw["evaluations"]}
