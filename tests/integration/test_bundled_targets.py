from pathlib import Path

import numpy as np
import pytest

from common.domain.deviation import deviation
from common.storage.cases import read_cases
from services.simulator.model import SimulatorModel

FOLDER = Path(__file__).parents[2] / "examples" / "scenes"


@pytest.mark.timeout(300)
def test_bundled_targets_are_what_the_simulator_makes_of_their_true_actions():
    model = SimulatorModel()
    for case in read_cases(FOLDER):
        if case.same_item:
            outcome = model.predict(case.state, np.array([case.true_action]))
            assert outcome.warnings == ("",)
            assert deviation(outcome.heights[0], case.target) < 2e-4, (
                f"{case.name}: the simulator has changed, run `python -m pipelines.cases --force` and commit the result"
            )


@pytest.mark.timeout(300)
def test_bundled_targets_of_the_same_item_are_placements_that_a_hand_could_repeat():
    model = SimulatorModel()
    aside = 3e-4 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    for case in read_cases(FOLDER):
        if case.same_item:
            outcomes = model.predict(case.state, np.array(case.true_action) + aside)
            assert (deviation(outcomes.heights, case.target) < 5e-4).all(), case.name
