"""In which order the orchestrator names the models."""

import pytest

from services.orchestrator import by_cost


@pytest.mark.parametrize(
    ("costs", "expected"),
    [
        ({"simulator": 0.1, "heuristic": 5e-5, "learned": 4e-3}, ["heuristic", "learned", "simulator"]),
        (
            {"simulator": None, "heuristic": None, "simulator_coarse": None},
            ["heuristic", "simulator_coarse", "simulator"],
        ),
        ({"simulator": 0.1, "heuristic": None}, ["heuristic", "simulator"]),
        ({"simulator": 0.1, "heuristic": 5e-5, "fourth": None}, ["heuristic", "fourth", "simulator"]),
        ({"simulator": 0.1, "simulator_fine": 2.0, "heuristic": None}, ["heuristic", "simulator", "simulator_fine"]),
        ({"simulator": None, "heuristic": 5e-5}, ["heuristic", "simulator"]),
        ({"heuristic": None, "fourth": 0.01}, ["fourth", "heuristic"]),
    ],
)
def test_models_are_ordered_by_cost_and_unmeasured_ones_come_before_the_trusted_one(costs, expected: list[str]):
    assert by_cost(costs, trusted="simulator") == expected
