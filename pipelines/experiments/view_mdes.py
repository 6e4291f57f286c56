"""Table II: the MDEs' errors before and after fine-tuning."""

from collections.abc import Mapping

import numpy as np

from pipelines.experiments.experiment import Experiment
from pipelines.experiments.judged import Judged
from pipelines.experiments.numbers import Number, number
from pipelines.experiments.raw import Raw, Row
from pipelines.experiments.shown import Shown
from pipelines.experiments.statistics import Estimate, Sample

ROWS = {
    ("s2s", "sim"): "S2S MDE on simulated placements",
    ("s2s", "real"): "S2S MDE on the stand-in's trials",
    ("s2r", "real"): "fine-tuned S2R MDE on the stand-in's trials",
}
"""(stage, set) -> what a reader sees; the rows of Table II."""
PAPERS_WAY = "last"
"""How the paper fine-tunes: the last layer alone."""
UNIT = "scaled [0-1]"


def mde_errors(experiment: Experiment, results: Mapping[str, Raw]) -> Shown:
    """Return ``<stage>.<set>.<model>``, the mean absolute error over samples and seeds, its deviation over the seeds.

    Other ways to fine-tune than the paper's are ``s2r_<way>.real.<model>``; ``constant.<set>.<model>`` is the error of
    the median of the training data; ``improvement.<model>`` is fine-tuned minus not fine-tuned, paired by seed and
    sample.
    """
    rows = [row for raw in results.values() for row in raw.rows]
    numbers: list[Number] = []
    for model in dict.fromkeys(row["model"] for row in rows):
        numbers += _of_model(experiment, model, [row for row in rows if row["model"] == model])
    return Shown(tuple(numbers))


def _of_model(experiment: Experiment, model: str, rows: list[Row]) -> list[Number]:
    found: dict[str, tuple[str, Judged]] = {}
    for (stage, place), text in ROWS.items():
        own = [row for row in rows if (row["stage"], row["set"]) == (stage, place)]
        for way in dict.fromkeys(row["method"] for row in own):
            suffix = "" if stage == "s2s" or way == PAPERS_WAY else f"_{way}"
            label = text if not suffix else f"{text}, {way}"
            found[f"{stage}{suffix}.{place}"] = label, Judged.of([row for row in own if row["method"] == way])

    def made(key: str, label: str, estimate: Estimate, judged: Judged, *, std: float | None = None) -> Number:
        seeds, count = judged.seeds, len(judged.groups)
        return number(experiment, key, (label, model), estimate, UNIT, seeds=seeds, samples=count, std=std)

    numbers: list[Number] = []
    for key, (label, judged) in found.items():
        sample = Sample(judged.groups, seeds=len(judged.seeds))
        std = float(np.std(judged.errors.mean(axis=1), ddof=1)) if len(judged.seeds) > 1 else None
        numbers.append(made(f"{key}.{model}", label, sample.mean(judged.errors), judged, std=std))
        if key.startswith("s2s."):
            constant = sample.mean(judged.constant)
            numbers.append(made(f"constant.{key[4:]}.{model}", f"a constant in place of the {label}", constant, judged))
    before, after = (found.get(f"{stage}.real") for stage in ("s2s", "s2r"))
    if before and after and before[1].seeds == after[1].seeds:
        sample = Sample(after[1].groups, seeds=len(after[1].seeds))
        change = sample.difference(after[1].errors, before[1].errors)
        numbers.append(made(f"improvement.{model}", "fine-tuned minus not, paired", change, after[1]))
    return numbers
