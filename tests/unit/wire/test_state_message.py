import pytest

from common.domain.errors import RequestError
from common.wire.codec import Format, decode, encode
from common.wire.messages import StateRequest
from common.wire.state import StateMessage
from tests.fakes import make_state


@pytest.mark.parametrize("form", ["msgpack", "json"])
@pytest.mark.parametrize("bodies", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_a_state_keeps_its_digest_on_the_wire(form: Format, bodies: bool, seed: int):
    state = make_state(seed, bodies=bodies)
    message = StateMessage.of(state)
    back = decode(*encode(message, form=form), StateMessage).state()
    assert back.digest == state.digest
    assert decode(*encode(StateMessage.of(back), form=form), StateMessage).state().digest == state.digest


def test_heights_that_do_not_fit_the_grid_are_refused():
    message = StateMessage.of(make_state())
    other = message.model_copy(update={"grid": message.grid.model_copy(update={"rows": 9})})
    with pytest.raises(RequestError, match=r"scene.heights: expected shape \(9, 10\), got \(8, 10\)"):
        other.state()


def test_a_request_names_or_carries_a_state():
    state = make_state()
    with pytest.raises(RequestError, match="the digest in 'state', the state in 'content', or both, got neither"):
        decode(b'{"actions": {"dtype": "bool", "shape": [1], "data": "AA=="}}', "application/json", StateRequest)
    assert StateMessage.of(state).state().digest == state.digest
