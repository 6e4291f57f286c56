"""Laws of certificates and of deadlines over strategies."""

import threading
import time
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from common.domain.deviation import DeviationEstimator, Estimates
from common.domain.model import Event
from common.domain.scene import State
from common.domain.trial import Result
from common.planning.optimize import optimize
from common.planning.plan_transport import ENOUGH, TransportPlan
from common.planning.selection import STRATEGIES
from services.heuristic import HeuristicModel
from tests.laws.test_strategies import PROBLEM, Draping

SCALE_M = 2e-3
TRANSPORTS = ["quality", "balanced", "fast", "transport:calls=5"]


@dataclass
class Bounded(DeviationEstimator):
    """The same estimate and bound everywhere."""

    upper: float = 0.8
    scale_m: float | None = SCALE_M
    familiar: bool = True
    model: str = "heuristic"
    version: str = "1"

    def deviations(self, state: State, actions: NDArray[np.float64]) -> Estimates:
        ones = np.ones(len(actions))
        return Estimates(0.5 * self.upper * ones, self.upper * ones, ones * self.familiar > 0, scale_m=self.scale_m)


def run(strategy: str, *estimators: DeviationEstimator, **options) -> Result:
    models = {model.name: model for model in (HeuristicModel(), Draping())}
    named = {estimator.model: estimator for estimator in estimators}
    return optimize(PROBLEM, models, named, **{"strategy": strategy, "evaluations": 14, **options})


@pytest.mark.parametrize("in_flight", [1, 3])
@pytest.mark.parametrize("strategy", TRANSPORTS)
def test_transport_says_how_much_better_another_action_may_be(strategy: str, in_flight: int):
    result = run(strategy, Bounded(), in_flight=in_flight)
    found = result.certificate
    assert found is not None
    assert result.in_flight == in_flight
    assert found.gain > 0
    assert 0 < found.probability < 1
    assert 0 <= found.left <= 1
    assert 49 <= found.actions <= 64 + 49


def test_more_calls_of_the_simulator_allow_less():
    fast, quality = (run(strategy, Bounded()).certificate for strategy in ("fast", "quality"))
    assert fast is not None
    assert quality is not None
    assert quality.gain < fast.gain


def test_deviations_that_calls_reveal_correct_the_bounds():
    """Where model and simulator are one, the bounds shrink with every call; the MDE expected 0.8 mm."""

    def certified(simulator) -> float:
        found = optimize(
            PROBLEM,
            {"heuristic": HeuristicModel(), "simulator": simulator},
            {"heuristic": Bounded()},
            strategy="transport:calls=4",
        ).certificate
        assert found is not None
        return found.gain

    class Same(HeuristicModel):
        name = "simulator"

    assert certified(Same()) < certified(Draping())


@pytest.mark.parametrize(
    "estimators", [(), (Bounded(scale_m=None),), (Bounded(familiar=False),)], ids=["no MDE", "no scale", "unfamiliar"]
)
def test_without_a_bound_there_is_no_certificate(estimators: tuple[Bounded, ...]):
    result = run("transport:calls=4", *estimators)
    assert result.certificate is None
    assert len(result.trials) == len(run("transport:calls=4", Bounded(upper=0.8)).trials)


@pytest.mark.parametrize("strategy", [name for name in STRATEGIES if name.partition(":")[0] in ("threshold", "random")])
def test_strategies_that_cannot_say_give_none(strategy: str):
    assert run(strategy, Bounded()).certificate is None


@pytest.mark.parametrize("in_flight", [1, 2])
def test_a_plan_ends_when_the_certificate_allows_no_more_gain(in_flight: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("common.planning.certificate.FACTORS", {"heuristic": 1.0})
    tight, wide = (run("quality", Bounded(upper=upper), in_flight=in_flight) for upper in (1e-4, 0.8))
    assert tight.certificate is not None
    assert tight.certificate.gain <= ENOUGH
    assert len(tight.trials) < len(wide.trials)


class Blocked(TransportPlan):
    """Computes for ever, once it was told something."""

    release = threading.Event()

    def ask(self) -> NDArray[np.float64] | None:
        if self._rewards:
            self.release.wait(60)
        return super().ask()


@pytest.mark.parametrize("in_flight", [1, 2])
def test_a_plan_that_computes_for_ever_does_not_hold_the_answer(in_flight: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("common.planning.strategy_transport.TransportPlan", Blocked)
    began = time.monotonic()
    try:
        result = run("quality", Bounded(), deadline_s=2.0, in_flight=in_flight)
    finally:
        took_s = time.monotonic() - began
        Blocked.release.set()
        Blocked.release = threading.Event()
    assert took_s < 20
    assert result.trials[0].model == "simulator"
    assert result.action == result.trials[0].action
    assert result.certificate is None


@pytest.mark.parametrize("strategy", [*TRANSPORTS, "residual:calls=5"])
def test_a_sweep_that_stalls_leaves_its_first_batches_as_the_answer(strategy: str):
    release, began = threading.Event(), time.monotonic()

    class Stalling(HeuristicModel):
        calls = 0

        def outcomes(self, state, actions):
            self.calls += 1
            if self.calls > 3:
                release.wait(60)
            return super().outcomes(state, actions)

    try:
        result = optimize(
            PROBLEM, {"heuristic": Stalling(), "simulator": Draping()}, {}, strategy=strategy, deadline_s=2.0
        )
    finally:
        took_s = time.monotonic() - began
        release.set()
    assert took_s < 20
    assert [trial.model for trial in result.trials] == ["heuristic"]


def test_a_failed_call_does_not_keep_a_cheap_answer_back_at_the_deadline():
    release, begun = threading.Event(), threading.Event()

    def trouble(call: int) -> None:
        if call == 0:
            raise ZeroDivisionError
        begun.set()
        release.wait(60)

    class Failing(Draping):
        def outcomes(self, state, actions):
            from common.domain.errors import ModelError

            try:
                return super().outcomes(state, actions)
            except ZeroDivisionError:
                raise ModelError("it slipped") from None

    try:
        result = optimize(
            PROBLEM,
            {"heuristic": HeuristicModel(), "simulator": Failing(trouble=trouble)},
            {},
            strategy="quality",
            deadline_s=1.0,
            clock=lambda: 1.0 if begun.is_set() else 0.0,
        )
    finally:
        release.set()
    assert result.trials[-1].model == "heuristic"
    assert [event.kind for event in result.events if isinstance(event, Event)] == ["model_error"]
