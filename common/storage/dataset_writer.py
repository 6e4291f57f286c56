"""Write a data set state by state, so that a process that is killed at any time loses and doubles nothing."""

import fcntl
import hashlib
import json
import os
from collections import Counter
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import ValidationError

from common.domain.errors import RequestError, UnavailableError
from common.storage.dataset import Dataset
from common.storage.dataset_arrays import SplitArrays
from common.storage.dataset_card import SPLITS, DatasetCard, DatasetPlan, Split
from common.storage.dataset_ranges import find_ranges
from common.storage.dataset_record import StateRecord, StateSamples

ROOM = 64
"""States by which the arrays grow."""


class DatasetWriter:
    """A data set that grows; as a context, it is this process's alone.

    A state counts once its line in ``states.jsonl`` is complete, which is written after its chunks. When all are
    there, the lines are put in order, surplus states are cut off, and the card is written. Files of the same plan are
    then equal byte for byte, except ``timings.jsonl``.

    Args:
        path: Folder of the data set.
        plan: What it is made from.

    Raises:
        RequestError: The folder holds something else, or a data set of another plan.
        UnavailableError: Another process writes to it.
    """

    def __init__(self, path: Path, plan: DatasetPlan) -> None:
        self.path, self.plan = path, plan
        self._prepare()
        self._folder = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._folder)
            raise UnavailableError(f"expected {path} for this process alone, got another that writes to it") from None
        for left in path.rglob("*.partial"):
            left.unlink()
        self._arrays = {
            split: SplitArrays.create(path / split, grid=plan.grid.grid(), actions_per_state=plan.actions_per_state)
            for split in SPLITS
        }
        self._records = {split: _resume(path / split / "states.jsonl") for split in SPLITS}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._folder)

    @property
    def is_complete(self) -> bool:
        """Whether the card is there."""
        return (self.path / "card.json").exists()

    def settled(self, split: Split) -> dict[int, int]:
        """Return number of the state -> samples that came to rest, for the states that are there."""
        return {index: record.settled for index, record in self._records[split].items()}

    def add(self, split: Split, made: StateSamples) -> None:
        """Keep a state; one that is there already stays as it is."""
        if made.index in self._records[split]:
            return
        arrays = self._arrays[split]
        if made.index >= arrays.states:
            arrays.resize(made.index + ROOM)
        if made.state is not None:
            scene, item = made.state.scene, made.state.item
            arrays.write("scene_heights", made.index, scene.heights)
            arrays.write("scene_materials", made.index, scene.materials)
            arrays.write("item_heights", made.index, item.heights)
            arrays.write("item_materials", made.index, item.materials)
            arrays.write("actions", made.index, made.actions)
            arrays.write("outcomes", made.index, made.outcomes)
        record = StateRecord.of(made)
        timing = {"split": split, "index": made.index, "wall_s": [round(seconds, 4) for seconds in made.wall_s]}
        _append(self.path / "timings.jsonl", json.dumps(timing))
        _append(self.path / split / "states.jsonl", record.model_dump_json())
        self._records[split][made.index] = record

    def finish(self) -> Dataset:
        """Cut off what is surplus, write the card and return the complete data set.

        Raises:
            RequestError: States are missing.
        """
        if not self.is_complete:
            self._card().write(self.path / "card.json")
        return Dataset.open(self.path)

    def _card(self) -> DatasetCard:
        kept: dict[Split, tuple[StateRecord, ...]] = {}
        sha256: dict[Split, str] = {}
        for split in SPLITS:
            kept[split] = _shortest(self._records[split], self.plan.counts[split], split)
            content = "".join(record.model_dump_json() + "\n" for record in kept[split]).encode()
            unfinished = self.path / split / "states.jsonl.partial"
            unfinished.write_bytes(content)
            unfinished.replace(self.path / split / "states.jsonl")
            sha256[split] = hashlib.sha256(content).hexdigest()
            self._arrays[split].resize(len(kept[split]))
            _remove_empty_folders(self.path / split)
        card = DatasetCard(
            **self.plan.model_dump(),
            states={split: len(records) for split, records in kept.items()},
            failed={split: _failures(records) for split, records in kept.items()},
            ranges={},
            sha256=sha256,
        )
        samples = Dataset(self.path, card, kept).samples("train")
        return card.model_copy(update={"ranges": find_ranges(samples)})

    def _prepare(self) -> None:
        plan = self.path / "plan.json"
        if plan.exists():
            there = DatasetPlan.read(plan)
            for name in DatasetPlan.model_fields:
                if getattr(there, name) != getattr(self.plan, name):
                    raise RequestError(
                        f"{self.path}: expected a data set with {name} {getattr(self.plan, name)!r}, "
                        f"got one with {getattr(there, name)!r}; use another name, or delete the folder"
                    )
            return
        if self.path.exists() and any(not left.name.endswith(".partial") for left in self.path.iterdir()):
            raise RequestError(f"expected {self.path} to be new, empty or a data set, got a folder of something else")
        self.path.mkdir(parents=True, exist_ok=True)
        self.plan.write(plan)


def _append(path: Path, line: str) -> None:
    with path.open("ab") as file:
        file.write(line.encode() + b"\n")


def _remove_empty_folders(path: Path) -> None:
    for folder, _, _ in os.walk(path, topdown=False):
        if not os.listdir(folder):
            os.rmdir(folder)


def _resume(path: Path) -> dict[int, StateRecord]:
    """Return the complete lines by the state's number, and cut off one that a kill left incomplete."""
    if not path.exists():
        return {}
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    try:
        records = [StateRecord.model_validate_json(line) for line in whole.splitlines()]
    except ValidationError as error:
        raise RequestError(f"{path}: expected one state a line, got {error.errors()[0]['msg']}") from None
    return {record.index: record for record in records}


def _shortest(records: dict[int, StateRecord], wanted: int, split: Split) -> tuple[StateRecord, ...]:
    """Return the first states, as many as make up the wanted number of settled samples."""
    kept: list[StateRecord] = []
    settled = 0
    while settled < wanted:
        record = records.get(len(kept))
        if record is None:
            raise RequestError(
                f"expected {wanted} settled samples in {split}, got {settled}: state {len(kept)} is missing"
            )
        kept.append(record)
        settled += record.settled
    return tuple(kept)


def _failures(records: tuple[StateRecord, ...]) -> dict[str, int]:
    """Return how often each kind of failure occurred: the word before the colon of each warning."""
    reasons = [record.reason for record in records] + [text for record in records for text in record.warnings]
    return dict(sorted(Counter(reason.split(":")[0] for reason in reasons if reason).items()))
