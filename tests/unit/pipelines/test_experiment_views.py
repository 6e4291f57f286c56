"""Numbers and figures of made-up raw results."""

import pytest

from common.domain.errors import RequestError
from pipelines.experiments.experiment import Experiment, Series, read_experiments
from pipelines.experiments.numbers import Number, written
from pipelines.experiments.parameters import MdeErrors, Parameters
from pipelines.experiments.shown import Shown
from pipelines.experiments.views import VIEWS
from tests.unit.pipelines.experiments_fakes import judgements, raw, results

FOUND = {one.name: one for one in read_experiments()}


def show(name: str) -> tuple[Shown, dict[str, Number]]:
    experiment = FOUND[name]
    shown = VIEWS[experiment.view](experiment, results(experiment))
    return shown, {one.key: one for one in shown.numbers}


def test_table1_has_errors_in_centimetres_with_ratios_and_times():
    shown, numbers = show("table1")
    assert shown.figure is None
    heuristic = numbers["sim.heuristic"]
    assert (heuristic.value, heuristic.unit, heuristic.samples) == (pytest.approx(0.75), "cm", 4)
    assert heuristic.std == pytest.approx(0.1 * 3 * 1.118, rel=1e-3)
    assert heuristic.low is not None
    assert heuristic.low < 0.75 < (heuristic.high or 0)
    assert heuristic.paper is not None
    assert heuristic.paper.value == 1.7558
    assert numbers["ratio.sim.learned"].value == pytest.approx(2 / 3)
    assert numbers["time.learned"].value == pytest.approx(2.0)
    assert numbers["time.simulator_rigid"].samples == 4  # two of each set


def test_table2_has_both_stages_and_the_paired_improvement():
    _, numbers = show("table2")
    assert numbers["s2s.sim.heuristic"].value == pytest.approx(0.11)
    assert numbers["s2s.sim.heuristic"].std == pytest.approx(0.01)
    assert numbers["s2s.sim.heuristic"].seeds == (0, 1, 2)
    assert numbers["improvement.learned"].value == pytest.approx(-0.2)
    assert numbers["improvement.learned"].high == pytest.approx(-0.2)
    assert numbers["s2r_full.real.learned"].row.endswith("full")
    assert numbers["constant.sim.learned"].value == pytest.approx(0.05)


def test_error_and_time_are_means_over_the_targets_with_paired_ratios():
    shown, numbers = show("sim_error_time")
    assert numbers["ours.error"].value == pytest.approx(4.5)
    assert numbers["ours.median"].value == pytest.approx(4.5)
    assert numbers["ours.error_ratio"].value == pytest.approx(1.5)
    assert numbers["ours.error_ratio"].low == pytest.approx(1.5)
    assert numbers["ours.time_ratio"].value == pytest.approx(0.25)
    assert numbers["ours.calls"].value == 2
    assert "simulator.time_ratio" not in numbers
    assert numbers["simulator.time"].paper is not None
    assert shown.figure is not None
    left, right = shown.figure.axes
    assert (left.get_yscale(), right.get_yscale()) == ("linear", "log")
    assert [label.get_text() for label in left.get_xticklabels()][3] == "Our Method (H/L/S)"


def test_usage_counts_evaluated_actions_by_model_and_sweeps_apart():
    shown, numbers = show("sim_usage")
    assert [numbers[f"ours.{model}"].value for model in ("heuristic", "learned", "simulator")] == [3, 1, 2]
    assert numbers["learned.learned"].value == 6
    assert numbers["quality.swept"].value == 30
    assert "ours.swept" not in numbers
    assert shown.figure is not None


def test_one_method_of_two_measurements_is_two_series():
    experiment = FOUND["real_error_time"]
    found = dict(results(experiment))
    rows = [{**row, "action_error_m": 0.5 * row["action_error_m"]} for row in found["s2r"].rows]
    found["s2r"] = raw(rows, parameters=experiment.measurements["s2r"])
    numbers = {one.key: one for one in VIEWS["error_and_time"](experiment, found).numbers}
    assert numbers["ours_s2r.error"].value == pytest.approx(0.5 * numbers["ours_s2s.error"].value)


def test_a_target_that_a_method_failed_at_counts_for_none():
    experiment = FOUND["sim_error_time"]
    found = results(experiment)["optimise"]
    for row in found.rows:
        if (row["method"], row["target"]) == ("fast", 4):
            row["error"] = "model: the solver diverged"
    numbers = VIEWS["error_and_time"](experiment, {"optimise": found}).numbers
    assert {one.samples for one in numbers} == {4}
    assert numbers[0].value == pytest.approx(7.5)


def test_a_series_without_raw_results_is_told_of():
    experiment = FOUND["sim_usage"]
    found = results(experiment)["optimise"]
    rows = [row for row in found.rows if row["method"] != "fast"]
    with pytest.raises(RequestError, match="sim_usage: expected raw results of fast, got none"):
        VIEWS["usage"](experiment, {"optimise": raw(rows, parameters=experiment.measurements["optimise"])})


def test_examples_have_a_line_of_four_panels_each():
    shown, numbers = show("sim_results")
    assert numbers["fries.error"].value == pytest.approx(3.0)
    assert numbers["fries.error"].low is None
    assert shown.figure is not None
    titles = [ax.get_title() for ax in shown.figure.axes]
    assert len([title for title in titles if title]) == 3 * 4
    assert "heuristic 3, learned 1, simulator 2" in titles


@pytest.fixture
def curves() -> Experiment:
    cases = {"data": "narrow-v1"}
    return Experiment(
        name="pretrained",
        title="Curves",
        of="A figure",
        order=1,
        about="",
        view="learning_curves",
        measurements={"sizes": MdeErrors(kind="mdes", cases=cases, models=("learned",))},  # type: ignore[arg-type]
        series=tuple(Series(key=key, label=key, method=key) for key in ("pretrained", "scratch")),
    )


def test_curves_have_a_number_for_each_size_and_the_paired_difference(curves: Experiment):
    rows = [
        row
        for trials in (5, 80)
        for method, error in (("pretrained", 1 / trials), ("scratch", 0.3))
        for row in judgements("learned", error=error, method=method, trials=trials)
    ]
    shown = VIEWS["learning_curves"](curves, {"sizes": raw(rows)})
    numbers = {one.key: one for one in shown.numbers}
    assert numbers["pretrained.5"].value == pytest.approx(0.21)
    assert numbers["scratch.80"].value == pytest.approx(0.31)
    assert numbers["difference.scratch.80"].value == pytest.approx(1 / 80 - 0.3)
    assert (numbers["scratch.80"].seeds, numbers["scratch.80"].samples) == ((0, 1, 2), 6)
    assert shown.figure is not None
    assert [line.get_label() for line in shown.figure.axes[0].get_lines()] == ["pretrained", "scratch"]


def test_one_number_of_trials_is_a_point_and_none_a_line_named_with_its_value(curves: Experiment):
    rows = [
        row
        for method, trials in (("pretrained", 80), ("scratch", 0))
        for row in judgements("learned", error=0.3, method=method, trials=trials)
    ]
    figure = VIEWS["learning_curves"](curves, {"sizes": raw(rows)}).figure
    assert figure is not None
    assert [line.get_label() for line in figure.axes[0].get_lines()] == ["pretrained", "scratch: 0.31"]
    low, high = figure.axes[0].get_ylim()
    assert 0 < low < 0.31 < high


def test_a_seed_that_has_not_judged_every_sample_is_told_of(curves: Experiment):
    rows = [row for method in ("pretrained", "scratch") for row in judgements("learned", error=0.1, method=method)]
    with pytest.raises(RequestError, match="expected 3 seeds with one judgement of 6 samples each, got 17"):
        VIEWS["learning_curves"](curves, {"sizes": raw(rows[1:])})


def test_numbers_are_written_with_three_digits():
    values = (0.0, 0.05001, 0.99951, 1.0, 12.345, 123.4, 12345.6, -0.004567, None)
    assert [written(value) for value in values] == [
        "0", "0.0500", "1.00", "1.00", "12.3", "123", "12346", "-0.00457", "-",
    ]  # fmt: skip


def test_parameters_say_what_they_need():
    assert FOUND["table1"].needed == {"narrow-v1", "real-v1"}
    assert Parameters(kind="any").needed == frozenset()
