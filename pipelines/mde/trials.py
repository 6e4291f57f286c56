"""Real trials: what a robot tried and what came of it, with how far a model was from that."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.deviation import deviation
from common.domain.errors import ModelError, RequestError
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.storage.dataset import Samples
from common.storage.dataset_cases import samples_of_cases


@dataclass(frozen=True)
class Trials:
    """Trials that a model could predict.

    Attributes:
        name: What they are called.
        model: The model.
        model_version: Its version.
        cases: N trials.
        samples: The same as arrays; trials of one state share a group.
        deviation_m: ``d(f(s_0, a), s_T)`` ``(N,)`` [m].
        digest: SHA-256 in hex of states, actions and outcomes.
        left_out: Why other trials were left out, one sentence each.
    """

    name: str
    model: str
    model_version: str
    cases: tuple[Case, ...]
    samples: Samples
    deviation_m: NDArray[np.float64]
    digest: str
    left_out: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return N."""
        return len(self.cases)

    @property
    def grid(self) -> Grid:
        """The grid of all trials."""
        return self.cases[0].state.grid

    def subset(self, chosen: NDArray[np.integer]) -> "Trials":
        """Return some of the trials, by their numbers ``(K,)``."""
        cases = tuple(self.cases[index] for index in chosen)
        samples = replace(samples_of_cases(cases), groups=self.samples.groups[chosen])
        return replace(
            self, cases=cases, samples=samples, deviation_m=self.deviation_m[chosen], digest=_digest(cases), left_out=()
        )

    def pairs(self) -> list[tuple[State, NDArray[np.float64]]]:
        """Return state and action ``(1, 2)`` [m] of every trial."""
        return [(case.state, action[None]) for case, action in zip(self.cases, self.samples.actions, strict=True)]

    @classmethod
    def predicted(
        cls,
        name: str,
        cases: Sequence[Case],
        model: PredictiveModel,
        *,
        report: Callable[[int], None] = lambda done: None,
    ) -> "Trials":
        """Return what a model says about trials; those that it fails on are left out.

        Args:
            name: What the trials are called.
            cases: The trials: the true action is the executed one, the target is the real outcome.
            model: Any model.
            report: Called with the number of trials that are done.

        Raises:
            RequestError: There is no trial, one has no action of its own item, the grids differ, or the model failed
                on every one.
        """
        samples_of_cases(cases)  # says what is wrong before anything is predicted
        taken: list[Case] = []
        found: list[float] = []
        left_out: list[str] = []
        for done, case in enumerate(cases, 1):
            try:
                heights = model.predict(case.state, np.array([case.true_action])).heights[0]
            except (ModelError, RequestError) as error:
                left_out.append(f"{case.name}: {error}")
            else:
                taken.append(case)
                found.append(float(deviation(heights, case.target)))
            report(done)
        if not taken:
            counted = f"none of {len(cases)}: {left_out[0]}"
            raise RequestError(f"trials: expected one that {model.name} can predict, got {counted}")
        states = {digest: index for index, digest in enumerate(dict.fromkeys(case.state.digest for case in taken))}
        groups = np.array([states[case.state.digest] for case in taken])
        samples = replace(samples_of_cases(taken), groups=groups)
        return cls(
            name, model.name, model.version, tuple(taken), samples, np.array(found), _digest(taken), tuple(left_out)
        )


def _digest(cases: Sequence[Case]) -> str:
    content = hashlib.sha256()
    for case in cases:
        content.update(case.state.digest.encode())
        content.update(np.array(case.true_action, "<f8").tobytes())
        content.update(np.ascontiguousarray(case.target, "<f4").tobytes())
    return content.hexdigest()
