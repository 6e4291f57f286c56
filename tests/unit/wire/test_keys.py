import pytest

from common.domain.errors import RequestError
from common.wire.keys import Address, alias, check_name, parse_address

ADDRESSES = [
    Address("plating", "model", "simulator", "a1b2"),
    Address("plating", "mde", "heuristic", "a1b2"),
    Address("plating", "orchestrator", None, "a1b2"),
]


def test_a_model_s_key_names_task_role_model_and_instance():
    assert ADDRESSES[0].key("predict") == "frugal/@v1/plating/model/simulator/a1b2/predict"


def test_an_orchestrator_s_key_has_no_model():
    assert ADDRESSES[2].key("cancel/x") == "frugal/@v1/plating/orchestrator/a1b2/cancel/x"


@pytest.mark.parametrize("address", ADDRESSES)
@pytest.mark.parametrize("leaf", ["live", "progress/abc"])
def test_a_key_is_parsed_back_to_its_address(address: Address, leaf: str):
    assert parse_address(address.key(leaf)) == (address, leaf)


@pytest.mark.parametrize(
    "key", ["", "frugal/@v1", "frugal/@v2/plating/model/a/b/live", "frugal/@v1/plating/cook/a/b/live"]
)
def test_a_foreign_key_is_refused(key: str):
    with pytest.raises(RequestError, match="expected a"):
        parse_address(key)


@pytest.mark.parametrize("name", ["", "a/b", "*", "a*", "@v1", "-a", "a b", "a#", "a?x", "ä", "x" * 65, "a\n"])
def test_a_name_that_is_no_single_chunk_is_refused(name: str):
    with pytest.raises(RequestError, match="task: expected 1 to 64 letters"):
        check_name("task", name)


def test_the_alias_of_a_task_is_short():
    assert alias("plating", "optimize") == "frugal/@v1/plating/optimize"


def test_workers_of_different_roles_have_different_short_names():
    assert [address.worker for address in ADDRESSES] == ["simulator/a1b2", "mde/heuristic/a1b2", "orchestrator/a1b2"]
