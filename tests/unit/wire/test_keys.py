import pytest

from common.domain.errors import RequestError
from common.wire.keys import Address, Role, alias, check_name, parse_address, robot_of, trial_key

ADDRESSES = [
    Address("plating", "model", "simulator", "a1b2"),
    Address("plating", "mde", "heuristic", "a1b2"),
    Address("plating", "orchestrator", None, "a1b2"),
    Address("plating", "recorder", None, "a1b2"),
    Address("plating", "world", None, "a1b2"),
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
    names = [address.worker for address in ADDRESSES]
    assert names[:2] == ["simulator/a1b2", "mde/heuristic/a1b2"]
    assert names[2:] == ["orchestrator/a1b2", "recorder/a1b2", "world/a1b2"]


@pytest.mark.parametrize(("role", "model"), [("model", None), ("mde", None), ("recorder", "m"), ("world", "m")])
def test_only_models_and_mdes_are_named_after_a_model(role: Role, model: str | None):
    with pytest.raises(RequestError, match=f"model: expected .* for the role {role}, got"):
        Address("plating", role, model, "a1b2")


def test_a_robot_s_key_is_parsed_back_to_its_name():
    assert trial_key("plating", "arm-1") == "frugal/@v1/plating/trial/arm-1"
    assert robot_of(trial_key("plating", "arm-1")) == "arm-1"
    assert robot_of("frugal/@v1/plating/recorder/a1b2/trial") is None
    for name in ("-a", "*", "a b"):
        with pytest.raises(RequestError, match="robot: expected 1 to 64 letters"):
            robot_of(f"frugal/@v1/plating/trial/{name}")


@pytest.mark.parametrize("address", ADDRESSES)
def test_no_robot_s_key_is_a_worker_s_and_no_worker_s_a_robot_s(address: Address):
    assert robot_of(address.key("trial")) is None
    with pytest.raises(RequestError, match="expected a worker's key"):
        parse_address(trial_key("plating", "arm-1"))
