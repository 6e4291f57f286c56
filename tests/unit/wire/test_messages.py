import numpy as np
import pytest

from common.domain.errors import ERRORS, FrugalError
from common.domain.model import Event
from common.domain.trial import Result, Trial
from common.wire.array import Array
from common.wire.codec import Format, decode, encode
from common.wire.messages import Card, ErrorReply, StateRequest
from common.wire.optimization import OptimizeReply, OptimizeRequest
from common.wire.state import StateMessage
from tests.fakes import make_state


@pytest.mark.parametrize("code", ERRORS)
def test_an_error_is_of_the_same_class_on_the_other_side(code: str):
    error = ErrorReply.of(ERRORS[code]("expected 1, got 2")).error()
    assert type(error) is ERRORS[code]
    assert str(error) == "expected 1, got 2"


def test_an_error_code_from_the_future_is_still_an_error():
    assert type(ErrorReply(code="melted", message="x").error()) is FrugalError


def test_a_result_comes_back_with_all_its_evidence():
    trial = Trial(0, (0.01, 0.02), "heuristic", "a", "1", -0.1, {"heuristic": 0.2}, "tilted", 0.1, 0.2, 0.15, "")
    failed = Trial(1, (0.0, 0.0), "simulator", "b", "1", None, error="it diverged")
    result = Result(
        action=(0.01, 0.02),
        reward=-0.1,
        heights=np.ones((2, 3), dtype=np.float32),
        trials=(trial, failed),
        usage={"heuristic": 1, "simulator": 1},
        models={"heuristic": "1", "simulator": "1"},
        split_s={"heuristic": 0.1, "mde": 0.2},
        wall_s=0.5,
        events=(Event("busy", "simulator/b", "busy", 0.3),),
        strategy="threshold",
        seed=7,
    )
    back = OptimizeReply.of(result, request_id="x", task="plating", instance="o").result()
    np.testing.assert_array_equal(back.heights, result.heights)
    for name in Result.__dataclass_fields__:
        if name != "heights":
            assert getattr(back, name) == getattr(result, name)


def test_requests_get_an_id_of_their_own():
    message = {"state": "0" * 64, "actions": {"dtype": "float32", "shape": [1], "data": bytes(4)}}
    assert StateRequest.model_validate(message).id != StateRequest.model_validate(message).id


def test_the_defaults_of_an_optimisation_are_the_paper_s():
    defaults = {name: field.default for name, field in OptimizeRequest.model_fields.items()}
    assert (defaults["evaluations"], defaults["in_flight"], defaults["d_max"]) == (50, None, 0.4)


def test_replies_may_say_more_than_this_version_knows():
    raw = {"task": "plating", "role": "model", "model": "m", "instance": "a", "version": "1", "colour": "blue"}
    assert Card.model_validate(raw).model == "m"


def a_request(**changes: object) -> OptimizeRequest:
    state = make_state(bodies=True)
    fields = {"id": "same", "state": StateMessage.of(state), "target": Array.of(state.scene.heights), **changes}
    return OptimizeRequest.model_validate(fields)


@pytest.mark.parametrize("form", ["msgpack", "json"])
def test_the_same_optimisation_has_the_same_identity_after_travelling(form: Format):
    request = a_request(bounds=((-0.01, 0.01), (0.0, 0.02)))
    assert decode(*encode(request, form=form), OptimizeRequest).identity() == request.identity()


@pytest.mark.parametrize(
    "changes",
    [
        {"id": "other"},
        {"state": StateMessage.of(make_state(1, bodies=True))},
        {"state": StateMessage.of(make_state())},
        {"target": Array.of(np.zeros((8, 10), np.float32))},
        {"bounds": ((-0.01, 0.01), (0.0, 0.02))},
        {"strategy": "random"},
        {"seed": 1},
        {"deadline_s": 1.0},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_an_optimisation_that_differs_in_one_field_has_another_identity(changes: dict[str, object]):
    assert a_request(**changes).identity() != a_request().identity()
