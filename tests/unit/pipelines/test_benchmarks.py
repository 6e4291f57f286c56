"""What the benchmarks begin with."""

from benchmarks.deadline import RUNS
from benchmarks.system import SPEED_UP_SCENES, bundled


def test_benchmarks_find_the_bundled_scenes_that_they_run_on():
    cases = bundled()
    assert len(cases) >= RUNS
    assert set(SPEED_UP_SCENES) <= set(cases)
    assert any(case.same_item and case.true_action is not None for case in cases.values())
