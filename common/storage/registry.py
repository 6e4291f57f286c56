"""Versions of released weights on disk, and which of them is active."""

import fcntl
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from common.domain.errors import RequestError, UnavailableError

CARD, TENSORS = "card.json", "weights.safetensors"
VERSIONS, ACTIVE, LOCK = "versions", "active.json", ".lock"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}(/[A-Za-z0-9][A-Za-z0-9_.-]{0,63})?")


@dataclass(frozen=True)
class Version:
    """One version of weights.

    Attributes:
        name: Whose weights: ``mde_heuristic``, ``narrow/mde_learned``, ...
        version: What its card calls it.
        folder: Where card and tensors are.
        card: The card.
        is_active: Whether it is the one that is served.
    """

    name: str
    version: str
    folder: Path
    card: dict[str, Any]
    is_active: bool


class Registry:
    """Weights below a folder: ``<name>/`` as released, ``versions/<name>/<version>/`` for what came later.

    Which version is active says ``versions/<name>/active.json``, the promotions that were not rolled back with their
    times; without any the released one is.

    Args:
        root: The folder.
    """

    def __init__(self, root: Path) -> None:
        self._root = root

    def names(self) -> tuple[str, ...]:
        """Return the names that have weights, in order."""
        released = [path.parent for path in (*self._root.glob(f"*/{CARD}"), *self._root.glob(f"*/*/{CARD}"))]
        found = {str(path.relative_to(self._root)) for path in released}
        later = self._root / VERSIONS
        added = (*later.glob(f"*/*/{CARD}"), *later.glob(f"*/*/*/{CARD}"))
        found |= {str(path.parent.parent.relative_to(later)) for path in added}
        return tuple(sorted(name for name in found if not name.startswith(f"{VERSIONS}/") and name != VERSIONS))

    def folder(self, name: str) -> Path:
        """Return the folder of the active version; of the released one, whether it is there or not, by default.

        Raises:
            RequestError: The active version is not there any more.
        """
        history = self._history(name)
        if not history:
            return self._root / name
        wanted = history[-1]["version"]
        for one in self._known(name):
            if one.is_active:
                return one.folder
        raise RequestError(
            f"{name}: expected its active version {wanted!r} in {self._root}, got none: add it again, or roll back"
        )

    def versions(self, name: str) -> tuple[Version, ...]:
        """Return all versions, the released one first; none of them is active if the active one is not there.

        Raises:
            RequestError: There is none.
        """
        found = self._known(name)
        if not found:
            raise RequestError(f"expected weights of {', '.join(self.names()) or 'some model'}, got {name!r}")
        return tuple(found)

    def add(self, name: str, folder: Path) -> Version:
        """Copy weights into the registry under the version that their card tells; what is there already stays.

        Raises:
            RequestError: The tensors are not those of the card, the card is of other weights, or the version exists
                with other tensors.
        """
        self._check_name(name)
        for part in (CARD, TENSORS):
            if not (folder / part).is_file():
                raise RequestError(f"weights: expected {folder / part}, got no such file")
        card = _card(folder)
        version, expected = str(card["version"]), name.rpartition("/")[2]
        if not NAME.fullmatch(version) or "/" in version:
            raise RequestError(f"{folder}: expected a version of letters, digits, '_', '.' and '-', got {version!r}")
        if card["name"] != expected:
            raise RequestError(f"{folder}: expected weights of {expected}, got those of {card['name']!r}")
        digest = hashlib.sha256((folder / TENSORS).read_bytes()).hexdigest()
        if digest != card["sha256"]:
            raise RequestError(f"{folder}: expected SHA-256 {card['sha256']} as the card says, got {digest}")
        for known in self._known(name):
            if known.version == version:
                if known.card["sha256"] != digest:
                    raise RequestError(f"{name}: expected a new version, got {version!r}, which has other weights")
                return known
        target = self._root / VERSIONS / name / version
        unfinished = target.with_name(f".{version}.{os.getpid()}")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        for part in (CARD, TENSORS):
            shutil.copyfile(folder / part, unfinished / part)
        unfinished.replace(target)
        return Version(name, version, target, card, is_active=False)

    def promote(self, name: str, version: str) -> Version:
        """Make a version the active one.

        Raises:
            RequestError: There is no such version.
        """
        found = [one for one in self._known(name) if one.version == version]
        if not found:
            known = ", ".join(one.version for one in self._known(name))
            raise RequestError(f"{name}: expected a version of {known or 'none'}, got {version!r}")
        if not found[0].is_active:
            step = {"version": version, "at": datetime.now(UTC).isoformat(timespec="seconds")}
            self._write(name, [*self._history(name), step])
        return found[0]

    def rollback(self, name: str) -> Version:
        """Make the version active that was active before, the released one in the end.

        Raises:
            RequestError: There is none.
        """
        history = self._history(name)
        wanted = history[-2]["version"] if len(history) > 1 else None
        previous = [
            one
            for one in self._known(name)
            if history and (one.folder == self._root / name if wanted is None else one.version == wanted)
        ]
        if not previous:
            raise RequestError(f"{name}: expected a version before the active one, got {wanted or 'none'}")
        self._write(name, history[:-1])
        return previous[0]

    def take_back(self, name: str) -> None:
        """Forget the last promotion, whether the version before is there or not."""
        self._write(name, self._history(name)[:-1])

    def remove(self, name: str, version: str) -> None:
        """Delete a version that was added and is not active."""
        history, folder = self._history(name), self._root / VERSIONS / name / version
        if folder in self._folders(name) and not (history and history[-1]["version"] == version):
            shutil.rmtree(folder)

    def owners(self, kind: str, sha256: str | None) -> set[str]:
        """Return the names, of those that end with ``kind``, that have a version with these tensors."""
        names = [name for name in self.names() if name.rpartition("/")[2] == kind]
        return {name for name in names if any(one.card["sha256"] == sha256 for one in self._known(name))}

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Keep out other processes that change versions, and ask for their turn too.

        Raises:
            UnavailableError: It is another process's turn.
            RequestError: There is no folder of weights.
        """
        if not self._root.is_dir():
            raise RequestError(f"expected a folder of weights, got no folder {self._root}")
        path = self._root / VERSIONS / LOCK
        path.parent.mkdir(exist_ok=True)
        with path.open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise UnavailableError(f"{path.parent}: expected nobody else to change versions now") from None
            yield

    def _known(self, name: str) -> list[Version]:
        history, first = self._history(name), self._root / name
        found: list[Version] = []
        for path in self._folders(name):
            if (path / CARD).is_file():
                card = _card(path)
                is_active = card["version"] == history[-1]["version"] if history else path == first
                found.append(Version(name, card["version"], path, card, is_active))
        return found

    def _folders(self, name: str) -> list[Path]:
        self._check_name(name)
        later = self._root / VERSIONS / name
        added = sorted(path for path in later.glob("[!.]*") if path.is_dir()) if later.is_dir() else []
        return [self._root / name, *added]

    def _history(self, name: str) -> list[dict[str, str]]:
        self._check_name(name)
        path = self._root / VERSIONS / name / ACTIVE
        if not path.is_file():
            return []
        try:
            found = json.loads(path.read_text())["promotions"]
            return [{"version": str(one["version"]), "at": str(one["at"])} for one in found]
        except (ValueError, KeyError, TypeError):
            raise RequestError(f"{path}: expected a list of promotions, got something else") from None

    def _write(self, name: str, history: list[dict[str, str]]) -> None:
        path = self._root / VERSIONS / name / ACTIVE
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_name(f".{ACTIVE}.{os.getpid()}")
        unfinished.write_text(json.dumps({"promotions": history}, indent=2) + "\n")
        unfinished.replace(path)

    def _check_name(self, name: str) -> None:
        if not NAME.fullmatch(name) or name.split("/")[0] == VERSIONS:
            raise RequestError(f"expected a name of weights, mde_heuristic for instance, got {name!r:.80}")


def _card(folder: Path) -> dict[str, Any]:
    path = folder / CARD
    try:
        card = json.loads(path.read_text())
        if not all(isinstance(card[field], str) for field in ("name", "version", "sha256")):
            raise TypeError
    except (ValueError, KeyError, TypeError):
        raise RequestError(f"{path}: expected a card with name, version and sha256, got something else") from None
    return card
