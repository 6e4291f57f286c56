"""``frugal evaluate``: the paper's tables and figures, and measurements of single parts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from services.cli.lazy import LazyGroup

PARTS: dict[str, tuple[str, str]] = {
    "models": ("services.cli.evaluate_models:models", "How far the models are from the trusted outcome, by region."),
    "mdes": ("services.cli.evaluate_mdes:mdes", "How good the MDEs are, by model and variant."),
    "certificate": (
        "services.cli.evaluate_certificate:certificate",
        "How often the certificate of an optimisation is wrong, and how much it allows.",
    ),
    "strategies": (
        "services.cli.evaluate_strategies:strategies",
        "Compare strategies with the simulator alone on the same targets.",
    ),
    "threshold": (
        "services.cli.evaluate_threshold:threshold",
        "Optimise held-out targets with all models and with the simulator alone.",
    ),
}
"""Name -> (where the command is, one line of help)."""

RAW = click.option(
    "--raw",
    type=click.Path(path_type=Path),
    default=Path("out/experiments"),
    show_default=True,
    help="Folder of all raw results.",
)
DATA = click.option(
    "--data", type=click.Path(path_type=Path), default=Path("data"), show_default=True, help="Folder of the data sets."
)
WORKERS = click.option(
    "--workers", type=click.IntRange(1, 64), default=2, show_default=True, help="Targets at the same time."
)
EXPERIMENTS_FOLDER = click.option(
    "--experiments", type=click.Path(path_type=Path, exists=True), help="Folder of other experiments than the paper's."
)


class EvaluateGroup(LazyGroup):
    """The written-out commands, and one for each experiment's file."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return experiments, then parts."""
        return [*(path.stem for path in _files(ctx)), *super().list_commands(ctx)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a part or of an experiment."""
        if cmd_name in PARTS or cmd_name not in self.list_commands(ctx):
            return super().get_command(ctx, cmd_name)
        options = {name: value for name, value in ctx.params.items() if name in ("workers", "raw", "data")}

        @click.command(cmd_name, help=f"Measure what {cmd_name} shows; `frugal report` shows it.")
        @WORKERS
        @RAW
        @DATA
        def one(**given: Any) -> None:
            changed = {name for name in given if _is_given(name)}
            _evaluate(ctx, [cmd_name], **{**options, **{name: given[name] for name in changed}})

        return one

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the experiments with their titles, then the parts."""
        import tomllib

        with formatter.section("Experiments"):
            contents = {path.stem: tomllib.loads(path.read_text()) for path in _files(ctx)}
            ordered = sorted(contents.items(), key=lambda found: found[1]["order"])
            formatter.write_dl([(name, f"{found['of']}: {found['title']}.") for name, found in ordered])
        with formatter.section("Parts"):
            formatter.write_dl([(name, text) for name, (_, text) in PARTS.items()])


@click.group(cls=EvaluateGroup, lazy=PARTS, invoke_without_command=True)
@click.option("--all", "everything", is_flag=True, help="Every experiment that belongs to the report.")
@click.option("--list", "as_list", is_flag=True, help="List the experiments, and what is measured of each.")
@WORKERS
@RAW
@DATA
@EXPERIMENTS_FOLDER
@click.pass_context
def evaluate(ctx: click.Context, *, everything: bool, as_list: bool, **options: Any) -> None:
    """Measure models, MDEs and whole optimisations: the paper's tables and figures, and single parts.

    Data sets that an experiment needs are generated from their seeds. What is measured is not measured again, and a run
    that was interrupted goes on; `frugal report` shows the results.
    """
    if ctx.invoked_subcommand is not None:
        if everything or as_list:
            raise click.UsageError(f"expected --all, --list or a name, got {ctx.invoked_subcommand} besides")
        return
    if as_list:
        _list(ctx)
    elif everything:
        _evaluate(ctx, None, **{name: options[name] for name in ("workers", "raw", "data")})
    else:
        click.echo(ctx.get_help())


def _files(ctx: click.Context) -> Sequence[Path]:
    folder = ctx.params.get("experiments")
    if folder is None:
        import pipelines.experiments as package

        folder = Path(package.__path__[0])
    return sorted(Path(folder).glob("*.toml"))


def _is_given(name: str) -> bool:
    return click.get_current_context().get_parameter_source(name) is not click.core.ParameterSource.DEFAULT


def _evaluate(ctx: click.Context, names: Sequence[str] | None, *, workers: int, raw: Path, data: Path) -> None:
    """Measure experiments by name, or all that belong to the report."""
    from pipelines.experiments.experiment import read_experiment
    from pipelines.experiments.place import Place
    from services.cli.evaluate_experiments import evaluate_experiments
    from services.cli.released import models_folder

    found = sorted((read_experiment(path) for path in _files(ctx)), key=lambda one: one.order)
    chosen = [one for one in found if (one.in_all if names is None else one.name in names)]
    evaluate_experiments(chosen, Place(models_folder(), data, raw, workers))


def _list(ctx: click.Context) -> None:
    from common.domain.errors import RequestError
    from pipelines.experiments.experiment import read_experiment
    from pipelines.experiments.measurements import find_raw

    for experiment in sorted((read_experiment(path) for path in _files(ctx)), key=lambda one: one.order):
        try:
            find_raw(experiment, ctx.params["raw"])
            state = "measured"
        except RequestError:
            state = "not measured" if experiment.in_all else "not measured, not in --all"
        click.echo(f"{experiment.name:18} {experiment.of}: {experiment.title} ({state})")
