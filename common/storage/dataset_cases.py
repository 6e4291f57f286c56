"""Cases with known actions as samples, so that own trials can be used where a data set's are."""

from collections.abc import Sequence

import numpy as np

from common.domain.case import Case
from common.domain.errors import RequestError
from common.storage.dataset import Samples


def samples_of_cases(cases: Sequence[Case]) -> Samples:
    """Return cases as samples, one state each, their targets as the outcomes.

    Raises:
        RequestError: There is no case, a case has no action of its own item, or the grids differ.
    """
    if not cases:
        raise RequestError("expected at least one case, got none")
    for case in cases:
        if case.reference_action is None or len(case.reference_action) != 2:
            raise RequestError(f"{case.name}: expected a case with its own item's action (x, y), got none")
        if case.state.grid != cases[0].state.grid:
            raise RequestError(
                f"{case.name}: expected {cases[0].state.grid} as in the first case, got {case.state.grid}"
            )
    unknown = ["unknown"] * len(cases)
    return Samples(
        scene_heights=np.stack([case.state.scene.heights for case in cases]),
        scene_materials=np.stack([case.state.scene.materials for case in cases]),
        item_heights=np.stack([case.state.item.heights for case in cases]),
        item_materials=np.stack([case.state.item.materials for case in cases]),
        actions=np.array([case.reference_action for case in cases], dtype=np.float64),
        outcomes=np.stack([case.target for case in cases]),
        groups=np.arange(len(cases)),
        rigid=np.array([case.state.item.is_rigid for case in cases]),
        kinds=unknown,
        layouts=list(unknown),
        places=list(unknown),
        warnings=[""] * len(cases),
    )
