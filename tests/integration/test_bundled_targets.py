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
