"""Data sets on disk: simulated placements, as NumPy arrays."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from common.domain.errors import RequestError
from common.domain.scene import Item, Scene, State
from common.storage.dataset_arrays import SplitArrays
from common.storage.dataset_card import FORMAT, SPLITS, DatasetCard, Split
from common.storage.dataset_record import StateRecord


@dataclass(frozen=True)
class Samples:
    """N samples of one split, in the order of their states.

    Attributes:
        scene_heights: ``(N, H, W)`` [m].
        scene_materials: Density, Young's modulus, Poisson's ratio of the topmost thing ``(N, 3, H, W)``.
        item_heights: ``(N, H, W)`` [m].
        item_materials: ``(N, 3, H, W)``.
        actions: ``(N, 2)`` [m].
        outcomes: Heightmaps of the simulator ``(N, H, W)`` [m]; NaN where there is none.
        groups: Number of the state ``(N,)``; samples of one state share it.
        rigid: Whether the item is one rigid body ``(N,)``.
        kinds: The item's outline, N names.
        layouts: How the fries lie, N names.
        places: What the action aimed at, N names.
        warnings: Why the sample failed, N sentences; empty where it came to rest.
    """

    scene_heights: NDArray[np.float32]
    scene_materials: NDArray[np.float32]
    item_heights: NDArray[np.float32]
    item_materials: NDArray[np.float32]
    actions: NDArray[np.float64]
    outcomes: NDArray[np.float32]
    groups: NDArray[np.int64]
    rigid: NDArray[np.bool_]
    kinds: list[str]
    layouts: list[str]
    places: list[str]
    warnings: list[str]

    def __len__(self) -> int:
        """Return N."""
        return len(self.actions)


class Dataset:
    """A complete data set.

    Attributes:
        path: Its folder.
        card: What is known about it.
    """

    def __init__(self, path: Path, card: DatasetCard, records: dict[Split, tuple[StateRecord, ...]]) -> None:
        self.path = path
        self.card = card
        self._records = records

    @classmethod
    def open(cls, path: Path | str) -> "Dataset":
        """Open a data set; its arrays are read when they are asked for.

        Raises:
            RequestError: There is none, it is not complete, or it was changed.
        """
        path = Path(path)
        if not (path / "card.json").exists():
            if (path / "plan.json").exists():
                raise RequestError(
                    f"expected a complete data set in {path}, got one without a card: run its `frugal data generate` "
                    "again, it goes on where it stopped"
                )
            raise RequestError(f"expected a data set ({FORMAT}) in {path}, got none")
        card = DatasetCard.read(path / "card.json")
        return cls(path, card, {split: _read_records(path / split / "states.jsonl", card, split) for split in SPLITS})

    def fix_deviation_scale(self, scale_m: float) -> None:
        """Write on the card which deviation estimates call 1 [m], once and for all.

        Raises:
            RequestError: It is not positive, or the card has another one already.
        """
        if not 0 < scale_m < np.inf:
            raise RequestError(f"expected a deviation scale above 0, got {scale_m}")
        if self.card.deviation_scale_m not in (None, scale_m):
            raise RequestError(
                f"{self.path}: expected to keep the deviation scale of {self.card.deviation_scale_m} m, got {scale_m} m"
            )
        self.card = self.card.model_copy(update={"deviation_scale_m": float(scale_m)})
        self.card.write(self.path / "card.json")

    def samples(self, split: Split, *, include_failed: bool = False) -> Samples:
        """Read all samples of a split.

        Args:
            split: ``train`` or ``test``.
            include_failed: Whether samples are included that did not come to rest or could not be simulated.

        Raises:
            RequestError: The arrays are not those that the card tells of.
        """
        arrays, records = self._arrays(split), self._split_records(split)
        per_state = self.card.actions_per_state
        taken = [
            (record, place)
            for record in records
            for place in range(per_state)
            if record.digest and (include_failed or not record.warnings[place])
        ]
        if not include_failed:
            taken = taken[: self.card.counts[split]]
        groups = np.array([record.index for record, _ in taken], dtype=np.int64)
        rows = groups * per_state + np.array([place for _, place in taken], dtype=np.int64)
        warnings = [record.warnings[place] for record, place in taken]
        actions, outcomes = arrays.read("actions")[rows], arrays.read("outcomes")[rows]
        scenes = {name: arrays.read(name)[groups] for name in _STATE_FIELDS}
        settled = np.array([not warning for warning in warnings], dtype=bool)
        for name, values in {**scenes, "actions": actions, "outcomes": outcomes[settled]}.items():
            _check_complete(self.path / split / name, values)
        return Samples(
            **scenes,
            actions=actions,
            outcomes=outcomes,
            groups=groups,
            rigid=np.array([record.rigid for record, _ in taken], dtype=bool),
            kinds=[record.kind for record, _ in taken],
            layouts=[record.layout for record, _ in taken],
            places=[record.places[place] for record, place in taken],
            warnings=warnings,
        )

    def state(self, split: Split, index: int) -> State:
        """Return a state by its number, as in `Samples.groups`, exactly as it was simulated.

        Raises:
            RequestError: There is no such state, or its arrays or bodies were changed.
        """
        records = self._split_records(split)
        if not 0 <= index < len(records):
            raise RequestError(f"expected a state from 0 to {len(records) - 1} of {split}, got {index}")
        record = records[index]
        if not record.digest:
            raise RequestError(f"expected a state of {split} that could be drawn, got {index}: {record.reason}")
        arrays = self._arrays(split)
        heights, materials, item, item_materials = (arrays.read(name, index, index + 1)[0] for name in _STATE_FIELDS)
        bodies = None if record.bodies is None else record.bodies.bodies()
        try:
            state = State(Scene(self.card.grid.grid(), heights, materials, bodies), Item(item, item_materials))
        except RequestError as error:
            raise RequestError(f"{self.path}: state {index} of {split}: {error}") from None
        if state.digest != record.digest:
            raise RequestError(
                f"{self.path}: expected state {index} of {split} with the digest {record.digest}, got {state.digest}"
            )
        return state

    def _split_records(self, split: Split) -> tuple[StateRecord, ...]:
        if split not in self._records:
            raise RequestError(f"expected a split of {', '.join(SPLITS)}, got {split!r}")
        return self._records[split]

    def _arrays(self, split: Split) -> SplitArrays:
        states = len(self._split_records(split))
        return SplitArrays.open(
            self.path / split, grid=self.card.grid.grid(), actions_per_state=self.card.actions_per_state, states=states
        )


_STATE_FIELDS = ("scene_heights", "scene_materials", "item_heights", "item_materials")


def _read_records(path: Path, card: DatasetCard, split: Split) -> tuple[StateRecord, ...]:
    if not path.exists():
        raise RequestError(f"expected the states of {split} in {path}, got no such file")
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != card.sha256[split]:
        raise RequestError(f"{path}: expected the SHA-256 on the card, {card.sha256[split]}, got a changed file")
    try:
        records = tuple(StateRecord.model_validate_json(line) for line in content.splitlines())
    except ValidationError as error:
        raise RequestError(f"{path}: expected one state a line, got {error.errors()[0]['msg']}") from None
    if [record.index for record in records] != list(range(card.states[split])):
        raise RequestError(f"{path}: expected the states 0 to {card.states[split] - 1}, got {len(records)} others")
    return records


def _check_complete(path: Path, values: NDArray[Any]) -> None:
    missing = int(np.isnan(values).reshape(len(values), -1).any(axis=1).sum()) if len(values) else 0
    if missing:
        raise RequestError(f"{path}: expected numbers for every sample, got none for {missing} of {len(values)}")
