import time
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pytest

from common.domain.errors import BusyError, ModelError, RequestError, UnavailableError
from common.domain.grid import Grid
from common.domain.model import Predictions, PredictiveModel
from common.domain.scene import State
from common.storage.dataset_card import DatasetPlan
from common.tasks.plating import FLAT_RADIUS, Plating
from pipelines.data.generate import generate
from pipelines.data.presets import LAYOUT_SHARES, PLACE_SHARES, WIDE_KINDS, draw_action, draw_state
from pipelines.data.remote import PatientModel
from pipelines.data.sample import make_state
from services.heuristic import HeuristicModel

GRID = Grid(48, 48, 0.006)
PLAN = DatasetPlan.model_validate(
    {
        "name": "small",
        "seed": 1,
        "preset": "wide",
        "counts": {"train": 7, "test": 3},
        "actions_per_state": 2,
        "grid": {"rows": 48, "columns": 48, "cell": 0.006},
        "model": "heuristic",
        "version": "1",
        "level": "default",
        "settings": {},
    }
)


def as_drawn(plate, boxes):
    return tuple(boxes)


class Restless(HeuristicModel):
    """Does not come to rest on the left."""

    def outcomes(self, state, actions):
        heights, _ = super().outcomes(state, actions)
        return heights, tuple("not_settled: 5 mm/s" if x < 0 else "" for x, _ in actions)


def run(path, *, in_flight=1, model=None, settle=as_drawn, stop_after=None, plan=PLAN):
    """Generate with threads; the later a state was handed out, the sooner it is done."""
    asked: list[tuple[str, int]] = []
    model = model or HeuristicModel()

    def make(split, index):
        time.sleep(0.01 * (3 - index % 4))
        return make_state(plan, split, index, settle=settle, model=model)

    def submit(split, index) -> Future:
        asked.append((split, index))
        if stop_after is not None and len(asked) > stop_after:
            raise KeyboardInterrupt
        return pool.submit(make, split, index)

    with ThreadPoolExecutor(in_flight) as pool:
        dataset = generate(path, plan, submit=submit, in_flight=lambda: in_flight, report=lambda split, count: None)
    return dataset, asked


def contents(path):
    return {
        str(found.relative_to(path)): found.read_bytes() if found.is_file() else b""
        for found in sorted(path.rglob("*"))
        if found.name != "timings.jsonl"
    }


@pytest.mark.parametrize("model", [HeuristicModel(), Restless()])
def test_the_number_of_states_at_work_leaves_no_trace(tmp_path, model):
    run(tmp_path / "one", model=model)
    run(tmp_path / "four", model=model, in_flight=4)
    assert contents(tmp_path / "one") == contents(tmp_path / "four")


@pytest.mark.parametrize("stop_after", [1, 3, 5])
def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, stop_after):
    _, asked = run(tmp_path / "one")
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "two", stop_after=stop_after)
    _, rest = run(tmp_path / "two")
    assert len(rest) < len(asked)
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_complete_set_is_not_made_again(tmp_path):
    run(tmp_path / "set")
    assert run(tmp_path / "set")[1] == []


def test_as_many_samples_come_to_rest_as_were_asked_for(tmp_path):
    dataset, asked = run(tmp_path / "set", model=Restless(), in_flight=2)
    assert len(dataset.samples("train")) == 7
    assert len(dataset.samples("test")) == 3
    assert dataset.card.failed["train"]["not_settled"] > 0
    assert len(asked) > 6


def test_a_scene_that_never_rests_is_a_failed_state_with_its_reason(tmp_path):
    calls = iter(range(1000))

    def settle(plate, boxes):
        if next(calls) < 20:
            raise ModelError("still moving")
        return tuple(boxes)

    dataset, _ = run(tmp_path / "set", settle=settle)
    assert dataset.card.failed["train"] == {"state": 1}
    assert dataset.samples("train").groups.min() == 1
    with pytest.raises(RequestError, match=r"expected a state of train that could be drawn, got 0: .*still moving"):
        dataset.state("train", 0)


def test_a_worker_of_another_version_ends_the_run(tmp_path):
    class Newer(HeuristicModel):
        def predict(self, state, actions):
            found = super().predict(state, actions)
            return Predictions(found.heights, found.warnings, self.name, "2", "worker-7")

    with pytest.raises(UnavailableError, match="expected heuristic 1 for the whole data set, got 2 from worker-7"):
        run(tmp_path / "set", model=Newer())


def drawn_states(preset, count):
    for seed in range(count):
        rng = np.random.default_rng(seed)
        layout = str(rng.choice(list(LAYOUT_SHARES)))
        yield rng, draw_state(rng, GRID, preset=preset, layout=layout, settle=as_drawn).state


def test_actions_lie_within_the_bounds_and_off_the_lattice_of_cells():
    actions = []
    for rng, state in drawn_states("wide", 20):
        low, high = Plating().bounds(state).T
        for _ in range(5):
            place, action = draw_action(rng, state)
            assert place in PLACE_SHARES
            assert (action >= low).all()
            assert (action <= high).all()
            assert np.hypot(*action) <= FLAT_RADIUS
            actions.append(action)
    parts = np.mod(np.array(actions) / GRID.cell, 0.5)
    assert (np.minimum(parts, 0.5 - parts) > 1e-6).all()


def test_an_action_that_aims_at_bare_plate_finds_it():
    found = 0
    for rng, state in drawn_states("wide", 30):
        for _ in range(4):
            place, action = draw_action(rng, state)
            if place == "bare":
                found += 1
                outcome = HeuristicModel().predict(state, action[None]).heights[0]
                covered = (outcome - state.scene.heights) > 0.5 * state.item.heights.max()
                assert not (covered & (state.scene.materials[0] > 0)).any()
    assert found > 10


def test_shares_add_up_to_one():
    for shares in (WIDE_KINDS, LAYOUT_SHARES, PLACE_SHARES):
        assert sum(shares.values()) == pytest.approx(1)


def test_an_unknown_preset_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(RequestError, match="expected a preset of wide, narrow, got 'broad'"):
        draw_state(rng, GRID, preset="broad", layout="heap", settle=as_drawn)


class Absent(PredictiveModel):
    """Nobody serves it for a while, or everybody is busy."""

    name, version = "absent", "1"

    def __init__(self, error, calls):
        self.error, self.calls = error, calls

    def outcomes(self, state, actions):
        raise AssertionError

    def predict(self, state, actions):
        self.calls -= 1
        if self.calls >= 0:
            raise self.error("nobody")
        return HeuristicModel().predict(state, actions)


def a_state() -> State:
    return next(drawn_states("narrow", 1))[1]


def test_workers_that_come_back_are_waited_for():
    model = PatientModel(Absent(UnavailableError, 2), patience_s=10)
    assert model.predict(a_state(), np.zeros((1, 2))).model == "heuristic"


def test_busy_workers_are_waited_for_however_long():
    model = PatientModel(Absent(BusyError, 2), patience_s=0)
    assert model.predict(a_state(), np.zeros((1, 2))).model == "heuristic"


def test_workers_that_do_not_come_back_end_the_run():
    with pytest.raises(UnavailableError, match="nobody"):
        PatientModel(Absent(UnavailableError, 100), patience_s=0).predict(a_state(), np.zeros((1, 2)))
