"""Which model answers which query."""

import pytest

from common.domain.errors import RequestError
from common.planning.selection import STRATEGIES, parse_strategy
from common.planning.strategy import Estimate, Query

MODELS = ("heuristic", "learned", "simulator")


def order(strategy: str, estimates: dict[str, Estimate], *, index: int = 0, d_max: float = 0.4):
    """Return the models in the order of trying, and those whose MDE was asked."""
    asked: list[str] = []

    def estimate(model: str) -> Estimate | None:
        asked.append(model)
        return estimates.get(model)

    query = Query(
        index=index,
        models=MODELS,
        estimable=frozenset(estimates),
        trusted="simulator",
        d_max=d_max,
        seed=0,
        estimate=estimate,
    )
    return list(parse_strategy(strategy).order(query)), asked


def test_threshold_tries_applicable_models_from_cheapest_to_dearest_then_the_trusted_one():
    good, bad = Estimate(0.1, 0.2, True), Estimate(0.5, 0.6, True)
    assert order("threshold", {"heuristic": good, "learned": good})[0] == ["heuristic", "learned", "simulator"]
    assert order("threshold", {"heuristic": bad, "learned": good})[0] == ["learned", "simulator"]
    assert order("threshold", {"heuristic": bad, "learned": bad})[0] == ["simulator"]


def test_a_model_at_the_threshold_is_not_applicable():
    assert order("threshold", {"heuristic": Estimate(0.4, 0.4, True)})[0] == ["simulator"]


def test_a_model_in_an_unfamiliar_situation_is_not_applicable():
    assert order("threshold", {"heuristic": Estimate(0.1, 0.1, False)})[0] == ["simulator"]


def test_a_model_without_an_mde_is_not_applicable():
    assert order("threshold", {})[0] == ["simulator"]
    assert order("random", {})[0] == ["simulator"]


def test_threshold_upper_compares_the_upper_bound():
    estimates = {"heuristic": Estimate(0.3, 0.5, True), "learned": Estimate(0.3, 0.39, True)}
    assert order("threshold", estimates)[0] == ["heuristic", "learned", "simulator"]
    assert order("threshold:upper", estimates)[0] == ["learned", "simulator"]


def test_the_first_applicable_model_spares_the_estimates_of_the_others():
    asked: list[str] = []

    def estimate(model: str) -> Estimate:
        asked.append(model)
        return Estimate(0.1, 0.1, True)

    query = Query(0, MODELS, frozenset(MODELS[:2]), "simulator", 0.4, 0, estimate)
    assert next(parse_strategy("threshold").order(query)) == "heuristic"
    assert asked == ["heuristic"]


def test_only_tries_the_named_model_and_asks_no_mde():
    assert order("only:learned", {"learned": Estimate(0.9, 0.9, False)}) == (["learned"], [])


def test_random_draws_every_model_and_the_same_one_for_the_same_query():
    estimates = {"heuristic": Estimate(0.9, 0.9, True), "learned": Estimate(0.9, 0.9, True)}
    orders = [order("random", estimates, index=index)[0] for index in range(60)]
    assert {models[0] for models in orders} == set(MODELS)
    assert all(models[-1] == "simulator" for models in orders)
    assert orders == [order("random", estimates, index=index)[0] for index in range(60)]


@pytest.mark.parametrize("name", [*STRATEGIES, "only:learned"])
def test_a_strategy_is_called_as_it_was_asked_for(name: str):
    assert parse_strategy(name).name == name


@pytest.mark.parametrize("name", ["", "treshold", "only", "only:", "threshold:lower", "THRESHOLD"])
def test_an_unknown_strategy_is_refused_with_the_known_ones(name: str):
    with pytest.raises(RequestError, match=r"expected one of threshold, .*, only:<model>, got"):
        parse_strategy(name)
