"""Sim-to-real MDEs made of sim-to-sim ones and trials."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.deviation import deviation
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Floats, Grid
from common.domain.scene import Item, Scene, State
from common.learning.training import threads
from common.learning.weights import WeightsCard
from pipelines.mde.descriptions import describe_samples
from pipelines.mde.finetune import FinetuneSettings, Method, examples_of, finetune, release_finetuned
from pipelines.mde.finetune_last import choose
from pipelines.mde.finetuned import calibrate
from pipelines.mde.trials import Trials
from services.heuristic import HeuristicModel
from services.mde.ensemble import Calibrated, load_ensemble
from services.mde.estimator import NetworkEstimator, read_estimator
from tests.mde_fakes import Sinking, make_trials, small_settings, write_dataset, write_weights

SHORT = 30
"""Iterations for what is not about how well it learns."""


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    with threads(1):
        yield


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Calibrated]:
    folder = tmp_path_factory.mktemp("bases")
    dataset = write_dataset(folder / "small")
    for variant, members in (("crop", 2), ("paper", 1)):
        write_weights(folder / variant, dataset, small_settings(variant, members=members, epochs=40))
    return {variant: load_ensemble(folder / variant, model="heuristic") for variant in ("crop", "paper")}


@pytest.fixture(scope="module")
def base(bases: dict[str, Calibrated]) -> Calibrated:
    return bases["crop"]


@cache
def trials(count: int, *, first: int = 0, shift_m: float = 0.0, share: float = 1.0) -> Trials:
    cases = make_trials(count, first=first, shift_m=shift_m, share=share)
    return Trials.predicted("kitchen", cases, HeuristicModel())


def settings(method: Method = "last", *, iterations: int = 500, seed: int = 0) -> FinetuneSettings:
    return FinetuneSettings(method=method, iterations=iterations, seed=seed)


def error_on(calibrated: Calibrated, judged: Trials) -> float:
    estimator, truth = NetworkEstimator(calibrated), examples_of(calibrated, judged).deviations
    found = [estimator.estimate(state, actions).mean[0] for state, actions in judged.pairs()]
    return float(np.abs(found - truth).mean())


def tuned(base: Calibrated, learned: Trials, how: FinetuneSettings, folder: Path) -> Calibrated:
    release_finetuned(base, learned, folder, how)
    return load_ensemble(folder, model=learned.model)


def test_deviations_are_those_of_the_model_from_the_real_outcomes():
    found, cases = trials(6, shift_m=0.0001), make_trials(6, shift_m=0.0001)
    for case, metres in zip(cases, found.deviation_m, strict=True):
        heights = HeuristicModel().predict(case.state, np.array([case.true_action])).heights[0]
        assert metres == pytest.approx(float(deviation(heights, case.target)))


def test_trials_of_one_state_share_a_group():
    first, second = make_trials(2)
    cases = [first, replace(first, name="again", true_action=(0.0, 0.01)), second]
    np.testing.assert_array_equal(Trials.predicted("kitchen", cases, HeuristicModel()).samples.groups, [0, 0, 1])


class Refusing(HeuristicModel):
    """Fails where the item goes to the left."""

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        if actions[0, 0] < 0:
            raise ModelError("no bodies found")
        return super().outcomes(state, actions)


def test_trials_that_the_model_fails_on_are_left_out_and_named():
    cases = make_trials(8)
    found = Trials.predicted("kitchen", cases, Refusing())
    left = [case.name for case in cases if case.true_action is not None and case.true_action[0] < 0]
    assert 0 < len(left) < 8
    assert found.left_out == tuple(f"{name}: no bodies found" for name in left)
    assert [case.name for case in found.cases] == [case.name for case in cases if case.name not in left]


def test_it_is_an_error_if_the_model_fails_on_every_trial():
    cases = [case for case in make_trials(8) if case.true_action is not None and case.true_action[0] < 0]
    with pytest.raises(RequestError, match=r"expected one that heuristic can predict, got none of .: trial.*no bodies"):
        Trials.predicted("kitchen", cases, Refusing())


def test_learning_nothing_is_chosen_only_where_it_is_clearly_better():
    rng, trained = np.random.default_rng(0), np.array([False, True, True])
    better, scattered = np.full(50, 0.10), rng.uniform(0.0, 0.2, 50)
    slightly, clearly = scattered - 0.002, scattered - 0.05
    scattered_again = rng.permutation(scattered)
    assert choose(np.stack([slightly, scattered_again, scattered_again + 0.01]), trained) == 1
    assert choose(np.stack([clearly, scattered, scattered + 0.01]), trained) == 0
    assert choose(np.stack([better, better + 0.03, better - 0.01]), trained) == 2


@pytest.mark.parametrize("variant", ["crop", "paper"])
def test_the_last_layers_alone_change(bases: dict[str, Calibrated], variant: str):
    base = bases[variant]
    before = {name: value.clone() for name, value in base.ensemble.state_dict().items()}
    after = finetune(base, trials(12, shift_m=0.0001), settings(iterations=SHORT)).finetuned.ensemble.state_dict()
    changed = {name for name in before if not np.array_equal(before[name].numpy(), after[name].numpy())}
    members = len(base.ensemble.networks)
    lasts = {f"members.{member}.last.{part}" for member in range(members) for part in ("weight", "bias")}
    assert lasts <= changed <= lasts | {"limits"}
    for name, value in base.ensemble.state_dict().items():
        np.testing.assert_array_equal(value.numpy(), before[name].numpy())


@pytest.mark.parametrize("method", ["last", "full", "scratch", "calibration"])
def test_the_same_seed_gives_the_same_bytes(base: Calibrated, tmp_path: Path, method: Method):
    how, learned = settings(method, iterations=4), trials(6, shift_m=0.0001)
    for name in ("one", "two"):
        release_finetuned(base, learned, tmp_path / name, how)
    for file in ("weights.safetensors", "card.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


@pytest.mark.parametrize("method", ["last", "full", "scratch", "calibration"])
@pytest.mark.parametrize("variant", ["crop", "paper"])
def test_what_is_written_is_what_was_trained_and_says_so(
    bases: dict[str, Calibrated], tmp_path: Path, method: Method, variant: str
):
    base, learned, how = bases[variant], trials(6, shift_m=0.0001), settings(method, iterations=4)
    card = release_finetuned(base, learned, tmp_path, how)
    inside = finetune(base, learned, how)
    written = load_ensemble(tmp_path, model="heuristic")
    expected = replace(written, ensemble=inside.finetuned.ensemble)
    expected.ensemble.facts.copy_(written.ensemble.facts)
    assert written.factor == inside.bound.factor
    for state, actions in learned.pairs():
        one, two = (found.estimate(state, actions) for found in (NetworkEstimator(expected), NetworkEstimator(written)))
        np.testing.assert_array_equal(one.mean, two.mean)
        np.testing.assert_array_equal(one.upper, two.upper)
    assert card.name == "mde_heuristic"
    assert card.version == f"1-s2r-{card.sha256[:8]}"
    assert (card.dataset.name, card.dataset.samples) == ("kitchen", 6)
    assert card.deviation_scale_m == base.card.deviation_scale_m
    assert card.settings["finetuning"]["method"] == method
    assert card.settings["finetuning"]["base"]["sha256"] == base.card.sha256
    assert card.metrics["before"]["samples"] == card.metrics["trials"] == 6
    assert 0 <= card.metrics["held_out"]["mae"] <= 1


@pytest.mark.parametrize("method", ["last", "full", "calibration"])
def test_what_the_world_does_differently_is_learned(base: Calibrated, tmp_path: Path, method: Method):
    learned, held_out = trials(24, shift_m=0.0001), trials(24, first=24, shift_m=0.0001)
    before = error_on(base, held_out)
    after = tuned(base, learned, settings(method, iterations=150 if method == "full" else 500), tmp_path)
    assert error_on(after, held_out) < 0.75 * before
    metrics = after.card.metrics
    assert metrics["held_out"]["mae"] < 0.75 * metrics["before"]["mae"]
    assert metrics["before"]["mae"] == pytest.approx(error_on(base, learned), abs=1e-6)


def test_a_world_that_scales_deviations_is_learned(base: Calibrated, tmp_path: Path):
    learned, held_out = trials(40, share=0.9), trials(24, first=40, share=0.9)
    after = tuned(base, learned, settings(), tmp_path)
    assert error_on(after, held_out) < 0.8 * error_on(base, held_out)


@pytest.mark.parametrize("first", [0, 5, 10])
def test_five_trials_of_the_known_world_do_little_harm(base: Calibrated, tmp_path: Path, first: int):
    after = tuned(base, trials(5, first=first), settings(), tmp_path)
    held_out = trials(24, first=24)
    assert error_on(after, held_out) < error_on(base, held_out) + 0.02


@pytest.mark.parametrize("method", ["last", "calibration"])
def test_the_bound_holds_for_new_trials(base: Calibrated, tmp_path: Path, method: Method):
    everyone = trials(100, shift_m=0.0001, share=0.9)
    covered: list[float] = []
    for seed in range(6):  # which 40 are learned from moves the coverage by 0.04
        drawn = np.random.default_rng(seed).permutation(100)
        learned, held_out = (everyone.subset(np.sort(part)) for part in (drawn[:40], drawn[40:]))
        after = tuned(base, learned, settings(method), tmp_path)
        estimator, truth = NetworkEstimator(after), examples_of(after, held_out).deviations
        uppers = np.array([estimator.estimate(state, actions).upper[0] for state, actions in held_out.pairs()])
        covered.append(float(np.mean(truth <= uppers + 1e-6)))
        assert uppers.mean() < 0.99
    assert 0.86 <= np.mean(covered) <= 0.98


def test_the_bound_holds_for_the_stated_share_of_new_trials():
    rng, covered, told = np.random.default_rng(0), [], []
    for _ in range(300):
        deviations, median, gap = rng.uniform(size=40), rng.uniform(size=40), rng.uniform(0.05, 0.2, 40)
        found = calibrate(deviations[:30], median[:30], gap[:30], coverage=0.9, least=None)
        covered.append((deviations[30:] <= median[30:] + found.factor * gap[30:]).mean())
        told.append(found.coverage)
    assert np.mean(covered) == pytest.approx(0.9, abs=0.02)
    assert np.mean(told) == pytest.approx(0.9, abs=0.02)


def test_few_trials_never_narrow_the_bound():
    rng = np.random.default_rng(0)
    exact = np.full(6, 0.3), np.full(6, 0.3), np.full(6, 0.1)
    found = calibrate(*exact, coverage=0.9, least=1.5)
    assert found.factor == 1.5
    assert "base" in found.rests_on
    wide = calibrate(np.full(6, 0.8), *exact[1:], coverage=0.9, least=1.5)
    assert wide.factor == pytest.approx(5)
    assert wide.rests_on == "largest of 6 trials"
    scores = rng.uniform(size=40)
    many = calibrate(scores, np.zeros(40), np.ones(40), coverage=0.9, least=1.5)
    assert many.factor == np.sort(scores)[36]  # the 37th of 40: ceil(41 * 0.9)
    assert many.coverage == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("method", ["last", "full", "scratch", "calibration"])
def test_the_trials_are_familiar_afterwards(base: Calibrated, tmp_path: Path, method: Method):
    learned = Trials.predicted("camera", [seen_by_a_camera(case) for case in make_trials(8)], HeuristicModel())
    strange = [NetworkEstimator(base).estimate(*pair) for pair in learned.pairs()]
    assert any("plate: expected" in one.reason for one in strange)
    after = NetworkEstimator(tuned(base, learned, settings(method, iterations=4), tmp_path))
    assert all(after.estimate(*pair).familiar.all() for pair in learned.pairs())


def seen_by_a_camera(case: Case) -> Case:
    """Return a trial whose scene is seen with noise, and whose item is softer than any that was simulated."""
    noise = np.random.default_rng(case.seed).normal(0, 0.0015, case.target.shape).astype(np.float32)
    scene, item = case.state.scene, case.state.item
    materials = item.materials.copy()
    materials[1][materials[1] > 0] = 2e3
    state = State(replace(scene, heights=scene.heights + noise), Item(item.heights, materials))
    return replace(case, state=state)


def test_what_was_familiar_stays_so_but_for_new_networks(base: Calibrated, tmp_path: Path):
    after = tuned(base, trials(6), settings(iterations=4), tmp_path / "last")
    for name, (low, high) in base.familiarity.ranges.items():
        assert after.familiarity.ranges[name][0] <= low
        assert after.familiarity.ranges[name][1] >= high
    assert after.familiarity.plate == base.familiarity.plate
    assert (after.ensemble.limits >= base.ensemble.limits).all()
    new = tuned(base, trials(6), settings("scratch", iterations=4), tmp_path / "scratch")
    low, high = new.familiarity.ranges["item's area [m2]"]
    areas = [float((case.state.item.heights > 0).sum()) * case.state.grid.cell**2 for case in trials(6).cases]
    assert (low, high) == pytest.approx((min(areas), max(areas)))


class Lifted(Sinking):
    """Stands for the simulator: the world has everything higher than it says, by more where fries lie."""


def test_the_trusted_model_gets_its_own_mde_from_that_of_another_one(base: Calibrated, tmp_path: Path):
    learned = Trials.predicted("kitchen", make_trials(24, share=0.8, shift_m=0.0005), Lifted())
    held_out = Trials.predicted("kitchen", make_trials(16, first=24, share=0.8, shift_m=0.0005), Lifted())
    card = release_finetuned(base, learned, tmp_path, settings())
    assert card.name == "mde_simulator"
    assert card.settings["finetuning"]["start"] in ("base", "fresh")
    assert card.settings["finetuning"]["base"]["name"] == "mde_heuristic"
    truth = examples_of(base, learned).deviations
    assert card.metrics["before"]["mae"] == pytest.approx(float(truth.mean()))  # sim-to-sim it is 0
    assert card.metrics["held_out"]["mae"] < 0.5 * card.metrics["before"]["mae"]
    assert read_estimator(tmp_path, model="simulator").model == "simulator"
    assert error_on(load_ensemble(tmp_path, model="simulator"), held_out) < 0.5 * float(
        examples_of(base, held_out).deviations.mean()
    )


def test_a_version_may_be_given(base: Calibrated, tmp_path: Path):
    card: WeightsCard = release_finetuned(base, trials(4), tmp_path, settings(iterations=4), version="kitchen-3")
    assert read_estimator(tmp_path, model="heuristic").version == card.version == "kitchen-3"


def test_trials_that_do_not_fit_are_refused(base: Calibrated):
    with pytest.raises(RequestError, match="trials: expected 2 or more of different states, got 1"):
        finetune(base, trials(1), settings())
    with pytest.raises(RequestError, match="expected at least one case, got none"):
        Trials.predicted("kitchen", [], HeuristicModel())
    case = make_trials(1)[0]
    with pytest.raises(RequestError, match=f"{case.name}: expected a case with its own item's action"):
        Trials.predicted("kitchen", [replace(case, true_action=None)], HeuristicModel())
    with pytest.raises(RequestError, match=r"trials: expected .* as of mde_heuristic, got"):
        finetune(base, Trials.predicted("kitchen", [on_another_grid()], HeuristicModel()), settings())


def on_another_grid() -> Case:
    grid = Grid(20, 24, 0.01)
    item = np.zeros(grid.shape, np.float32)
    item[8:12, 10:14] = 0.01
    materials = np.where(item > 0, np.array([1000.0, 1e5, 0.4])[:, None, None], 0).astype(np.float32)
    state = State(Scene(grid, np.zeros(grid.shape, np.float32), np.zeros_like(materials)), Item(item, materials))
    return Case("other", 0, state, item, (0.0, 0.0), True)


def test_every_symmetry_of_a_sample_is_described(base: Calibrated):
    samples = trials(3).samples
    turned, plain = (describe_samples(base.ensemble, samples, turned=value) for value in (True, False))
    assert turned.shape == (2, 8, 3, 8)
    np.testing.assert_array_equal(turned[:, :1].numpy(), plain.numpy())
    assert not np.array_equal(turned[:, 1].numpy(), plain[:, 0].numpy())
