import numpy as np
import pytest

from common.domain.errors import RequestError, UnknownStateError
from common.wire.array import Array
from common.wire.cost import CostMeter
from common.wire.messages import CancelReply, PredictReply
from common.wire.replies import LARGEST, ReplyCache
from common.wire.state import StateMessage
from common.wire.states import StateCache
from tests.fakes import make_state


def test_a_state_that_was_sent_is_found_by_its_digest():
    cache, state = StateCache(), make_state()
    first = cache.resolve(state.digest, StateMessage.of(state))
    assert first.digest == state.digest
    assert cache.resolve(state.digest, None) is first
    assert cache.resolve(None, StateMessage.of(state)) is first


def test_a_state_that_was_not_sent_is_asked_for():
    with pytest.raises(UnknownStateError, match="send it as 'content'"):
        StateCache().resolve("0" * 64, None)


def test_content_under_another_state_s_digest_is_refused():
    with pytest.raises(RequestError, match="expected the digest of 'content'"):
        StateCache().resolve("0" * 64, StateMessage.of(make_state()))


def test_the_least_recently_used_state_is_forgotten():
    cache, states = StateCache(largest_count=2), [make_state(seed) for seed in range(3)]
    cache.resolve(None, StateMessage.of(states[0]))
    cache.resolve(None, StateMessage.of(states[1]))
    cache.resolve(states[0].digest, None)
    cache.resolve(None, StateMessage.of(states[2]))
    cache.resolve(states[0].digest, None)
    with pytest.raises(UnknownStateError):
        cache.resolve(states[1].digest, None)


def test_states_are_forgotten_by_size_too_but_never_the_last_one():
    cache, states = StateCache(largest_bytes=1), [make_state(seed) for seed in range(2)]
    for state in states:
        cache.resolve(None, StateMessage.of(state))
    cache.resolve(states[1].digest, None)
    with pytest.raises(UnknownStateError):
        cache.resolve(states[0].digest, None)


def test_the_cost_is_the_median_of_the_last_computations_by_batch():
    meter = CostMeter()
    for seconds in [100.0] * 40 + [1.0] * 17 + [3.0] * 15:
        meter.record(1, seconds)
    meter.record(8, 5.0)
    assert [(cost.batch, cost.p50_s, cost.count) for cost in meter.costs()] == [(1, 1.0, 32), (8, 5.0, 1)]
    assert meter.median_s(2) is None


def test_an_answer_is_kept_for_a_retry_and_the_oldest_forgotten():
    cache = ReplyCache()
    replies = [CancelReply(id=str(number), found=True) for number in range(LARGEST + 1)]
    for number, reply in enumerate(replies):
        cache.keep(number, reply)
    assert cache.find(0) is None
    assert cache.find(1) is replies[1]


def test_an_answer_without_identity_is_not_kept():
    cache = ReplyCache()
    cache.keep(None, CancelReply(id="x", found=True))
    assert cache.find(None) is None


def reply_of(count: int) -> PredictReply:
    heights = Array.of(np.zeros((count, 8, 10), dtype=np.float32))
    return PredictReply(heights=heights, warnings=("",) * count, model="m", version="1", instance="a", compute_s=0.1)


def test_answers_are_forgotten_by_size_too():
    cache, replies = ReplyCache(largest_bytes=2**20), [reply_of(1000) for _ in range(4)]
    for number, reply in enumerate(replies):
        cache.keep(number, reply)
    assert [cache.find(number) for number in range(4)] == [None, None, replies[2], replies[3]]


def test_an_answer_that_is_too_large_is_not_kept_and_drives_no_other_out():
    cache, small = ReplyCache(largest_bytes=2**20), reply_of(1)
    cache.keep("small", small)
    cache.keep("large", reply_of(4096))
    assert cache.find("large") is None
    assert cache.find("small") is small


def test_an_answer_that_is_kept_twice_counts_once():
    cache, other = ReplyCache(largest_bytes=2**20), reply_of(1000)
    cache.keep("other", other)
    for _ in range(5):
        cache.keep("again", reply_of(1000))
    assert cache.find("other") is other
