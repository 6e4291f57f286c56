"""The command ``frugal``: every command is imported when it is called, so that ``--help`` is instant."""

import os
import sys

import click

from common.domain.errors import FrugalError
from services.cli.lazy import LazyGroup

COMMANDS: dict[str, tuple[str, str]] = {
    "up": ("services.cli.up:up", "Start router, workers and orchestrator on this machine, in the foreground."),
    "serve": (
        "services.cli.serve:serve",
        "Run one process of the system: router, a model's worker, orchestrator or recorder.",
    ),
    "workers": ("services.cli.workers:workers", "List the live workers with their cards, health and measured cost."),
    "optimize": ("services.cli.optimize:optimize", "Ask the running system for the best action of a scene."),
    "demo": ("services.cli.demo:demo", "Start everything, optimise one bundled scene, draw it, stop everything."),
    "watch": ("services.cli.watch:watch", "Watch workers and running optimisations live."),
    "simulate": ("services.cli.simulate:simulate", "Simulate one placement and draw it on its way to rest."),
    "bench": ("services.cli.bench:bench", "Measure the simulator and the optimiser, with others beside them."),
    "train": ("services.cli.train:train", "Train the networks: the learned model, the MDE of any model."),
    "finetune": ("services.cli.finetune:finetune", "Fine-tune MDEs on real trials, and choose the next trial."),
    "evaluate": ("services.cli.evaluate:evaluate", "Measure models, MDEs and whole optimisations: the paper's tables."),
    "models": ("services.cli.models:models", "Versions of weights: list, promote, roll back, while workers serve."),
    "report": ("services.cli.report:report", "Write the paper's tables and figures, ours beside them."),
    "trials": ("services.cli.trials:trials", "List, show, export and report trials that robots executed."),
    "data": ("services.cli.data:data", "Generate, show and import data sets."),
    "health": ("services.cli.health:health", "Tell whether this machine's router or worker answers."),
    "warm": ("services.cli.warm:warm", "Compile the simulator's kernels into the cache."),
}
"""Name -> (where the command is, one line of help)."""


@click.group(cls=LazyGroup, lazy=COMMANDS)
@click.version_option(package_name="frugal")
def frugal() -> None:
    """Choose a robot's action with several models, and pay for the slow one only where the fast ones fail."""


def main() -> None:
    """Run the command line; errors are one line, the exit code is 0 only if everything asked for was done."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads cost more than they bring
    try:
        frugal.main(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("frugal: interrupted", err=True)
        sys.exit(130)
    except OSError as error:
        click.echo(f"frugal: {error}", err=True)
        sys.exit(1)
    except ValueError as error:  # a setting from the environment, as pydantic tells it
        click.echo(f"frugal: {_in_one_line(error)}", err=True)
        sys.exit(1)
    except FrugalError as error:
        click.echo(f"frugal: {error.code}: {error}", err=True)
        sys.exit(1)


def _in_one_line(error: ValueError) -> str:
    found = getattr(error, "errors", None)
    if found is None:
        return str(error)
    first = found()[0]
    name = "FRUGAL_" + "_".join(str(part) for part in first["loc"]).upper()
    return f"{name}: {first['msg'].replace('Input should be', 'expected')}, got {first['input']!r}"


if __name__ == "__main__":
    main()
