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


class OnCases(Parameters, frozen=True):
    """Something that is measured on cases.

    Attributes:
        cases: Which.
        weights: Folder below the released weights, by what is loaded: ``learned``, ``mde_heuristic``, ...
    """

    cases: Cases
    weights: dict[str, str] = {}

    @property
    def needed(self) -> frozenset[str]:
        """Return the names of data sets and folders of trials."""
        return self.cases.sources


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
    """What S2S MDEs say about simulated test samples and about trials.

    Attributes:
        real: Trials that they are also asked about.
        models: Whose MDEs.
        trainings: Seeds of the trainings; released weights are taken where they were trained like this.
        epochs: Passes over the data, None: the usual number.
    """

    kind: Literal["mdes"] = "mdes"
    real: Cases | None = None
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
        return self.cases.sources | (self.real.sources if self.real else frozenset())


AnyParameters = Annotated[ModelErrors | Optimisations | Examples | MdeErrors, Field(discriminator="kind")]
