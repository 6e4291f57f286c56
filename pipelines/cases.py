"""Make cases: draw a state from a seed, simulate a hidden action as its target, write both with a card."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import Progress

from common.domain.case import Case
from common.domain.errors import FrugalError, ModelError
from common.domain.grid import Grid
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.storage.cases import read_case, write_case
from common.tasks import TASKS
from common.tasks.plating_sampler import Settler, sample_action, sample_item, sample_scene
from common.tasks.plating_turn import turned_state

ATTEMPTS = 20


@dataclass(frozen=True)
class CaseRecipe:
    """What a case has to show; everything that is None is drawn from the seed.

    Attributes:
        name: Name of the case and its file.
        seed: Seed of every random choice.
        layout: How the fries lie, see `common.tasks.plating_sampler.LAYOUTS`.
        kind: The item's outline, see `common.tasks.plating_sampler.ITEM_KINDS`.
        rigid: Whether the item is one rigid body.
        place: Where the hidden action is, see `common.tasks.plating_sampler.PLACES`.
        same_item: Whether the target is made with the state's own item.
        notes: One sentence about what it shows.
        yaw: Whether the hidden action also turns the item, by any angle: a case of ``plating_yaw``.
    """

    name: str
    seed: int
    layout: str | None = None
    kind: str | None = None
    rigid: bool | None = None
    place: str | None = None
    same_item: bool = True
    notes: str = ""
    yaw: bool = False


BUNDLED = (
    CaseRecipe("01-steak-heap", 101, "heap", "steak", False, "heap_edge", notes="A soft steak over a heap's edge."),
    CaseRecipe("02-steak-rim", 102, "scattered", "steak", False, "rim", notes="A soft steak that reaches the rim."),
    CaseRecipe("03-rigid-heap", 103, "heap", "t_bone", True, "heap_edge", notes="A rigid T-bone on a heap's edge."),
    CaseRecipe("04-medallion-bare", 104, "side_heap", "medallion", None, "bare", notes="A medallion on bare plate."),
    CaseRecipe("05-irregular-heaps", 105, "small_heaps", "irregular", False, "heap_edge", notes="Between small heaps."),
    CaseRecipe("06-rigid-rim", 406, "side_heap", "ellipse", True, "rim", notes="A rigid item that leans on the rim."),
    CaseRecipe("07-other-heap", 107, "heap", "steak", False, "heap_edge", False, "Another item made the target."),
    CaseRecipe("08-other-rigid", 108, "small_heaps", "irregular", True, "anywhere", False, "Another, rigid item."),
)
"""The scenes in ``examples/scenes``."""

BUNDLED_YAW = (
    CaseRecipe("11-turned-irregular", 901, "small_heaps", "irregular", False, "heap_edge", notes="Turned.", yaw=True),
    CaseRecipe("12-turned-rigid", 902, "side_heap", "t_bone", True, "anywhere", notes="A turned T-bone.", yaw=True),
)
"""The scenes in ``examples/scenes_yaw``."""


def make_case(recipe: CaseRecipe, *, settle: Settler, model: PredictiveModel, grid: Grid) -> Case:
    """Draw a state and a hidden action, and simulate the action as target; draw again where it does not rest.

    Args:
        recipe: What the case has to show.
        settle: Lets fries fall and come to rest.
        model: The trusted model; an outcome it warns about is not used as a target.
        grid: The grid of state and target.

    Raises:
        ModelError: No draw gave a target at rest.
    """
    reason, task = "", TASKS["plating_yaw" if recipe.yaw else "plating"]
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([recipe.seed, attempt])
        scene = sample_scene(rng, grid, settle=settle, layout=recipe.layout)
        state = State(scene, sample_item(rng, grid, kind=recipe.kind, rigid=recipe.rigid))
        maker = state if recipe.same_item else State(scene, sample_item(rng, grid, rigid=recipe.rigid))
        if recipe.yaw:
            yaw = rng.uniform(-np.pi, np.pi)
            action = np.append(sample_action(rng, turned_state(maker, yaw), place=recipe.place), yaw)
        else:
            action = sample_action(rng, maker, place=recipe.place)
        try:
            outcome = task.adapt_model(model).predict(maker, action[None])
        except ModelError as error:
            reason = str(error)
            continue
        if not outcome.warnings[0]:
            true_action = tuple(float(number) for number in action)
            return Case(
                recipe.name,
                recipe.seed,
                state,
                outcome.heights[0],
                true_action,
                recipe.same_item,
                recipe.notes,
                task=task.name,
            )
        reason = outcome.warnings[0]
    raise ModelError(f"{recipe.name}: expected a target at rest within {ATTEMPTS} draws, the last failed: {reason}")


def random_recipes(count: int, seed: int, *, yaw: bool = False) -> tuple[CaseRecipe, ...]:
    """Return recipes in which everything is drawn; every second target is made with another item."""
    return tuple(
        CaseRecipe(f"{seed}-{index:05d}", seed * 100_003 + index, same_item=index % 2 == 0, yaw=yaw)
        for index in range(count)
    )


def make_cases(
    recipes: Sequence[CaseRecipe],
    out: Path,
    *,
    settle: Settler,
    model: PredictiveModel,
    grid: Grid,
    force: bool = False,
    progress: Progress | None = None,
) -> int:
    """Write the cases that ``out`` does not hold yet, and their card ``card.json``; return how many were made.

    A case is kept where its recipe, its grid and the model's name and version are those on the card and the file is
    the one that the card names by its SHA-256.
    """
    out.mkdir(parents=True, exist_ok=True)
    card_path = out / "card.json"
    card = json.loads(card_path.read_text()) if card_path.exists() else {}
    old, entries, made = card.get("cases", {}), {}, 0
    bar = progress.add_task("cases", total=len(recipes)) if progress else None
    for recipe in recipes:
        path = out / f"{recipe.name}.npz"
        settings = {**asdict(recipe), "model": model.name, "version": model.version, "grid": asdict(grid)}
        entry = old.get(recipe.name, {})
        fresh = path.exists() and entry.get("settings") == settings and entry.get("sha256") == _sha256(path)
        if force or not fresh:
            write_case(path, make_case(recipe, settle=settle, model=model, grid=grid))
            made += 1
        entries[recipe.name] = _entry(path, settings)
        card_path.write_text(json.dumps({"cases": {**old, **entries}}, indent=1) + "\n")
        if progress and bar is not None:
            progress.advance(bar)
    card_path.write_text(json.dumps({"cases": entries}, indent=1) + "\n")
    return made


def _entry(path: Path, settings: dict[str, object]) -> dict[str, object]:
    case = read_case(path)
    boxes = case.state.scene.bodies.boxes if case.state.scene.bodies else ()
    item = case.state.item
    return {
        "settings": settings,
        "sha256": _sha256(path),
        "fries": len(boxes),
        "rigid": item.is_rigid,
        "youngs_modulus": float(item.materials[1].max()),
        "thickness": float(item.heights.max()),
        "true_action": case.true_action,
    }


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), help="[default: examples/scenes, with --yaw examples/scenes_yaw]"
)
@click.option("--yaw", is_flag=True, help="Cases of plating_yaw: hidden actions also turn the item.")
@click.option("--count", type=click.IntRange(1, 100_000), help="Make random cases instead of the bundled ones.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the random cases.")
@click.option("--force", is_flag=True, help="Make every case again.")
def main(out: Path | None, yaw: bool, count: int | None, seed: int, force: bool) -> None:
    """Settle scenes, simulate their targets and write them as case files."""
    from services.simulator.model import SimulatorModel
    from services.simulator.settle import settle_boxes

    out = out or Path("examples/scenes_yaw" if yaw else "examples/scenes")
    bundled = BUNDLED_YAW if yaw else BUNDLED
    recipes = bundled if count is None else random_recipes(count, seed, yaw=yaw)
    try:
        with Progress(console=Console(stderr=True)) as progress:
            made = make_cases(
                recipes, out, settle=settle_boxes, model=SimulatorModel(), grid=Grid(), force=force, progress=progress
            )
    except FrugalError as error:
        raise click.ClickException(str(error)) from error
    click.echo(f"{made} of {len(recipes)} cases made in {out}, the others were up to date")


if __name__ == "__main__":
    main()
