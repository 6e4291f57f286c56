"""Trials in the world's stand-in: the robot looks at a table, places the steak somewhere, and looks again."""

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, as_completed
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from common.domain.case import Case
from common.domain.errors import FrugalError, ModelError
from common.domain.grid import Grid
from common.storage.cases import write_case
from pipelines.data.depth_case import Perceived, perceive
from pipelines.data.presets import draw_action
from services.world.world import StandIn

COUNTS = {"train": 80, "test": 20, "more": 200, "pool": 40}
"""Split -> tables. The first two are the paper's; ``more`` is for tight intervals, ``pool`` for a choice of actions."""
ACTIONS = {"pool": 6}
"""Split -> actions tried on each table; 1 elsewhere."""
FIRST_TABLE = {"train": 0, "test": 10_002, "more": 20_004, "pool": 30_006}
"""Split -> number of its first table."""
ATTEMPTS, NEXT_ATTEMPT = 6, 600_000
"""How often another table is tried where one failed, and how much further its number is: the steak stays the same."""


def make_trials(split: str, index: int) -> list[Case]:
    """Return the trials on table ``index`` of a split, one for each action.

    A table or action that fails, because nothing came to rest or the camera saw too little, is replaced by another.

    Raises:
        ModelError: All attempts failed.
    """
    count, reason = ACTIONS.get(split, 1), ""
    for attempt in range(ATTEMPTS):
        table = FIRST_TABLE[split] + index + attempt * NEXT_ATTEMPT
        try:
            seen, steak = look(table)
            rng = np.random.default_rng([table, 99])
            return [_try(split, index, number, table, seen, steak, rng) for number in range(count)]
        except FrugalError as error:
            reason = str(error)
    raise ModelError(f"{split} {index}: expected a trial within {ATTEMPTS} tables, the last failed: {reason}")


def look(table: int, *, grid: Grid | None = None) -> tuple[Perceived, str]:
    """Return the state of a table as the robot perceives it, and the steak's name."""
    sight = _world().look(table)
    return perceive(sight, grid=grid or Grid()), sight.name


def execute(table: int, perceived: Perceived, action: tuple[float, float]) -> NDArray[np.float32]:
    """Return the heightmap that the robot sees after an action ``(H, W)`` [m]."""
    return perceived.outcome(_world().execute(table, action))


def _try(
    split: str, index: int, number: int, table: int, seen: Perceived, steak: str, rng: np.random.Generator
) -> Case:
    place, drawn = draw_action(rng, seen.state)
    action = (float(drawn[0]), float(drawn[1]))
    outcome = execute(table, seen, action)
    name = f"{split}-{index:04d}" if split not in ACTIONS else f"{split}-{index:04d}-{number}"
    return Case(name, table, seen.state, outcome, action, same_item=True, notes=f"{steak}, {place}")


def generate_real(
    folder: Path,
    processes: Executor,
    *,
    counts: Mapping[str, int] = COUNTS,
    report: Callable[[int], None] = lambda done: None,
) -> None:
    """Write the trials that are missing, a case file each, and last a card.

    Args:
        folder: A folder with one folder a split.
        processes: Where trials are made.
        counts: Tables by split.
        report: Told of the number of tables that are done.
    """
    done = 0
    missing: list[tuple[str, int]] = []
    for split, tables in counts.items():
        (folder / split).mkdir(parents=True, exist_ok=True)
        for index in range(tables):
            last = f"{split}-{index:04d}" + (f"-{ACTIONS[split] - 1}" if split in ACTIONS else "")
            if (folder / split / f"{last}.npz").exists():
                done += 1
            else:
                missing.append((split, index))
    report(done)
    futures = {processes.submit(make_trials, split, index): split for split, index in missing}
    for future in as_completed(futures):
        for case in future.result():
            write_case(folder / futures[future] / f"{case.name}.npz", case)
        done += 1
        report(done)
    card = {"world": StandIn.version, "counts": dict(counts), "actions": ACTIONS, "first_table": FIRST_TABLE}
    (folder / "card.json").write_text(json.dumps(card, indent=2) + "\n")


@cache
def _world() -> StandIn:
    world = StandIn()
    world.warm()
    return world
