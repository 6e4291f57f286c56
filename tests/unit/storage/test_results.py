"""Results on disk and as a figure say what the trials say."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from common.domain.bodies import Material
from common.domain.case import Case
from common.domain.grid import Grid
from common.domain.model import Event
from common.domain.scene import Scene, State
from common.domain.trial import Result, Trial
from common.storage.results import action_error, other_errors, summarize, write_result
from common.tasks.plating_items import RoundedRectangle, draw_item
from pipelines.figures import draw_placement, save_figure
from tests.fakes import make_state

STATE = make_state(1)
CASE = Case("case", 1, STATE, STATE.scene.heights, (0.01, 0.02), True)
TRIALS = (
    Trial(0, (0.0, 0.0), "heuristic", "a", "1", -0.002),
    Trial(1, (0.013, 0.024), "simulator", "b", "2", -0.001, warning="not_settled: 4 mm/s"),
    Trial(2, (0.02, 0.02), "simulator", "", "", None, error="timed_out: too long"),
)
RESULT = Result(
    action=(0.013, 0.024),
    reward=-0.001,
    heights=STATE.scene.heights,
    trials=TRIALS,
    usage={"heuristic": 1, "simulator": 2},
    models={"heuristic": "1", "simulator": "2"},
    split_s={"heuristic": 0.1, "simulator": 0.2, "mde": 0.0, "optimiser": 0.01, "transport": 0.02},
    wall_s=0.4,
    events=(Event("no_reply", "simulator/b", "it died", 0.2),),
    strategy="threshold",
    seed=5,
)


def test_the_action_error_is_the_distance_to_the_true_action():
    assert action_error(RESULT, CASE) == pytest.approx(0.005)


def test_a_target_of_another_item_has_no_action_error():
    other = Case("case", 1, STATE, STATE.scene.heights, (0.01, 0.02), False)
    assert action_error(RESULT, other) is None
    assert summarize(RESULT, case=other, settings={})["action_error_m"] is None


def turned(yaw: float, true_yaw: float) -> tuple[Result, Case]:
    case = Case("case", 1, STATE, STATE.scene.heights, (0.01, 0.02, true_yaw), True, task="plating_yaw")
    return replace(RESULT, action=(0.013, 0.024, yaw), trials=()), case


def test_the_error_of_the_yaw_is_kept_apart_and_goes_the_short_way_round():
    result, case = turned(3.1, -3.1)
    assert action_error(result, case) == pytest.approx(0.005)
    assert other_errors(result, case) == {"yaw_error_rad": pytest.approx(2 * np.pi - 6.2)}
    assert summarize(result, case=case, settings={})["other_errors"]["yaw_error_rad"] == pytest.approx(2 * np.pi - 6.2)
    assert other_errors(RESULT, CASE) == {}
    assert other_errors(result, replace(case, same_item=False)) == {}


def test_the_figure_shows_the_item_as_it_is_turned():
    grid = Grid(60, 60, 0.003)
    steak = RoundedRectangle(0.12, 0.06, 0.01)
    item = draw_item(grid, steak, thickness=0.02, material=Material(1050.0, 1e5, 0.4))
    state = State(Scene(grid, np.zeros(grid.shape), np.zeros((3, *grid.shape))), item)
    result, case = turned(np.pi / 2, 0.0)
    result = replace(result, heights=state.scene.heights)
    case = replace(case, state=state, target=state.scene.heights)
    figure = draw_placement(case, result)
    outlines = [max(axes.collections[-1].get_paths(), key=len).vertices for axes in (figure.axes[0], figure.axes[3])]
    (wide, high), (turned_wide, turned_high) = (np.ptp(outline, axis=0) for outline in outlines)
    assert (wide, high) == pytest.approx((12, 6), abs=0.3)
    assert (turned_wide, turned_high) == pytest.approx((6, 12), abs=0.3)
    assert "turned by +90.0°" in figure.get_suptitle()


def test_every_trial_and_the_summary_are_written(tmp_path: Path):
    write_result(tmp_path / "out", RESULT, case=CASE, settings={"in_flight": 4})
    lines = (tmp_path / "out" / "trials.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [json.loads(json.dumps(asdict(trial))) for trial in TRIALS]
    summary = json.loads((tmp_path / "out" / "result.json").read_text())
    assert summary["evaluations"] == 3
    assert summary["settings"] == {"in_flight": 4}
    assert summary["events"][0]["worker"] == "simulator/b"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["result.json", "trials.jsonl"]


def test_the_figure_has_four_panels_in_centimetres_and_a_mark_for_each_model(tmp_path: Path):
    figure = draw_placement(CASE, RESULT)
    panels = figure.axes[:4]
    assert [ax.get_xlabel() for ax in panels] == ["x [cm]"] * 4
    half_x, half_y = (100 * half for half in STATE.grid.half_extent)
    assert panels[0].get_xlim() == pytest.approx((-half_x, half_x))
    assert panels[0].get_ylim() == pytest.approx((-half_y, half_y))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["item's outline", "true action", "heuristic (1)", "simulator (1)", "best action"]
    markers = {line.get_marker() for line in figure.legends[0].get_lines()}
    assert {"^", "o", "X"} <= markers
    best = panels[3].lines[-1]
    np.testing.assert_allclose([best.get_xdata()[0], best.get_ydata()[0]], [1.3, 2.4])
    png, svg = save_figure(figure, tmp_path / "figure")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert "best action" in svg.read_text()
