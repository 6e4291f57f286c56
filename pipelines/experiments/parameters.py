"""What a measurement is made with: equal parameters are measured once and shared by experiments."""

import hashlib
import json
from importlib.metadata import version
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, model_validator


class Parameters(BaseModel, extra="forbid", frozen=True):
    """Parameters of one kind of measurement; ``kind`` is its name."""

    kind: str
    seed: int = Field(default=0, ge=0)

    @property
    def folder(self) -> str:
        """Return the name of the folder of its raw results: equal parameters, equal folder.

        Whether a default is written out makes no difference.
        """
        written = self.model_dump(mode="json", exclude_defaults=True, exclude={"kind"})
        canonical = json.dumps(written, sort_keys=True, separators=(",", ":"))
        return f"{self.kind}-{hashlib.sha256(canonical.encode()).hexdigest()[:10]}"

    def about(self) -> dict[str, Any]:
        """Return kind, parameters and seeds as raw results have them, and the version of this package."""
        parameters = self.model_dump(mode="json", exclude={"kind"})
        return {"kind": self.kind, "parameters": parameters, "seeds": list(self.seeds), "version": version("frugal")}

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return every seed that is drawn from."""
        return (self.seed,)

    @property
    def needed(self) -> frozenset[str]:
        """Return the names of the data sets and trial folders that it reads."""
        return frozenset()


class Cases(BaseModel, extra="forbid", frozen=True):
    """Where cases come from: a split of a data set, or folders of trials.

    Attributes:
        data: Name of a data set; empty if trials are taken.
        split: Which part of it.
        per_state: Whether only the first sample of each state is taken.
        trials: Folders of case files below the data sets, for instance ``real-v1/test``, one after the other.
        count: The number of cases, evenly spread; None: all.
    """

    data: str = ""
    split: Literal["train", "test"] = "test"
    per_state: bool = False
    trials: tuple[str, ...] = ()
    count: int | None = Field(default=None, ge=1)

    @model_validator(mode="after")
    def _one_source(self) -> "Cases":
        if bool(self.data) == bool(self.trials):
            raise ValueError("expected either data or trials")
        return self

    @property
    def sources(self) -> frozenset[str]:
        """Return the names of data sets and folders of trials."""
        return frozenset(name.partition("/")[0] for name in (self.data, *self.trials) if name)


class Against(BaseModel, extra="forbid", frozen=True):
    """Another model that a model is compared with, on ``count`` cases evenly spread."""

    model: str
    count: int = Field(ge=1)


Way = Literal["last", "full", "scratch", "calibration"]
"""How an MDE is fine-tuned, see `pipelines.mde.finetune`."""


class Finetuned(BaseModel, extra="forbid", frozen=True):
    """MDEs that are fine-tuned before something is measured with them.

    Attributes:
        trials: What they are fine-tuned on.
        bases: Folder of the sim-to-sim weights below the released ones, by what is fine-tuned: ``mde_heuristic``, ...
        method: How.
        seed: Seed of it.
    """

    trials: Cases
    bases: dict[str, str]
    method: Way = "last"
    seed: int = 0


class OnCases(Parameters, frozen=True):
    """Something that is measured on cases.

    Attributes:
        cases: Which.
        weights: Folder below the released weights, by what is loaded: ``learned``, ``mde_heuristic``, ...
        finetuned: MDEs that are fine-tuned first.
    """

    cases: Cases
    weights: dict[str, str] = {}
    finetuned: Finetuned | None = None

    @property
    def needed(self) -> frozenset[str]:
        """Return the names of data sets and folders of trials."""
        return self.cases.sources | (self.finetuned.trials.sources if self.finetuned else frozenset())


class ModelErrors(OnCases, frozen=True):
    """How far models are from the outcomes.

    Attributes:
        models: Their names.
        against: What a model is compared with instead of the outcome, by its name.
    """

    kind: Literal["models"] = "models"
    models: tuple[str, ...] = Field(min_length=1)
    against: dict[str, Against] = {}


class Optimisations(OnCases, frozen=True):
    """Optimisations of the cases' targets by several methods.

    Attributes:
        family: The models, from cheapest to dearest; the last one is trusted.
        methods: What is compared, ``<strategy>[+<option>...]``.
        evaluations: Evaluations of an optimisation.
        resimulated: Whether the targets are simulated by the trusted model, from the cases' true actions.
    """

    kind: Literal["optimise"] = "optimise"
    family: tuple[str, ...] = Field(min_length=1)
    methods: tuple[str, ...] = Field(min_length=1)
    evaluations: int = Field(default=50, ge=1, le=5000)
    resimulated: bool = False


class Examples(OnCases, frozen=True):
    """Optimisations that are drawn, with the scene that the answer leads to.

    Attributes:
        family: As in `Optimisations`.
        method: What optimises.
        regions: The first target of each region is taken, see `pipelines.evaluate.regions`.
        evaluations: Evaluations of an optimisation.
        executed: Whether the achieved scene is seen in the world's stand-in instead of simulated by the trusted model.
    """

    kind: Literal["examples"] = "examples"
    family: tuple[str, ...] = Field(min_length=1)
    method: str = "threshold"
    regions: tuple[str, ...] = Field(min_length=1)
    evaluations: int = Field(default=50, ge=1, le=5000)
    executed: bool = False


class MdeErrors(OnCases, frozen=True):
    """What S2S MDEs say about simulated test samples and about trials, before and after fine-tuning.

    Attributes:
        real: Trials that they are also asked about.
        trials: Trials that they are fine-tuned on.
        ways: How.
        models: Whose MDEs.
        trainings: Seeds of the trainings; released weights are taken where they were trained like this.
        epochs: Passes over the data, None: the usual number.
    """

    kind: Literal["mdes"] = "mdes"
    real: Cases | None = None
    trials: Cases | None = None
    ways: tuple[Way, ...] = ("last",)
    models: tuple[str, ...] = Field(min_length=1)
    trainings: tuple[int, ...] = Field(default=(0, 1, 2), min_length=1)
    epochs: int | None = Field(default=None, ge=1)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return the seeds of the trainings."""
        return self.trainings

    @property
    def needed(self) -> frozenset[str]:
        """Return the names of data sets and folders of trials."""
        others = (self.real, self.trials)
        return self.cases.sources.union(*(one.sources for one in others if one is not None))


class OnTrials(OnCases, frozen=True):
    """What the MDE of a model learns from trials.

    Attributes:
        trials: What it may learn from.
        model: Whose MDE.
        counts: Numbers of trials.
        trainings: Seeds: which trials come first, and whatever is random in the training.
    """

    trials: Cases
    model: str
    counts: tuple[int, ...] = Field(min_length=1)
    trainings: tuple[int, ...] = Field(default=(0, 1, 2), min_length=1)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return the seeds of the trainings."""
        return self.trainings

    @property
    def needed(self) -> frozenset[str]:
        """Return the names of data sets and folders of trials."""
        return self.cases.sources | self.trials.sources


class SampleSize(OnTrials, frozen=True):
    """The error over the number of trials, by every method."""

    kind: Literal["sample_size"] = "sample_size"
    methods: tuple[Way, ...] = Field(min_length=1)


class ActiveChoice(OnTrials, frozen=True):
    """The error over the number of trials that were chosen, by every acquisition.

    Attributes:
        acquisitions: Names of `pipelines.mde.active.ACQUISITIONS`, or ``representative``.
        first: Trials that are drawn by chance before the first choice.
    """

    kind: Literal["active"] = "active"
    acquisitions: tuple[Literal["random", "lcb", "variance", "integrated", "representative"], ...] = Field(min_length=1)
    first: int = Field(default=5, ge=2)


AnyParameters = Annotated[
    ModelErrors | Optimisations | Examples | MdeErrors | SampleSize | ActiveChoice, Field(discriminator="kind")
]
