"""Versions of weights on disk."""

import hashlib
import json
from pathlib import Path

import pytest

from common.domain.errors import RequestError
from common.storage.registry import ACTIVE, CARD, TENSORS, VERSIONS, Registry


def write(folder: Path, *, version: str, name: str = "mde_heuristic", content: bytes = b"tensors") -> Path:
    folder.mkdir(parents=True)
    (folder / TENSORS).write_bytes(content)
    card = {"name": name, "version": version, "sha256": hashlib.sha256(content).hexdigest()}
    (folder / CARD).write_text(json.dumps(card))
    return folder


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    write(tmp_path / "models" / "mde_heuristic", version="1")
    write(tmp_path / "models" / "narrow" / "mde_heuristic", version="1")
    return Registry(tmp_path / "models")


def active(registry: Registry, name: str = "mde_heuristic") -> str:
    return next(one.version for one in registry.versions(name) if one.is_active)


def test_without_promotions_the_released_version_is_active(registry: Registry, tmp_path: Path):
    assert registry.names() == ("mde_heuristic", "narrow/mde_heuristic")
    assert registry.folder("mde_heuristic") == tmp_path / "models" / "mde_heuristic"
    assert active(registry) == "1"


def test_a_promoted_version_is_active_until_it_is_rolled_back(registry: Registry, tmp_path: Path):
    added = registry.add("mde_heuristic", write(tmp_path / "new", version="2", content=b"other"))
    assert active(registry) == "1"
    registry.promote("mde_heuristic", "2")
    assert active(registry) == "2"
    assert registry.folder("mde_heuristic") == added.folder
    assert (added.folder / TENSORS).read_bytes() == b"other"
    assert registry.rollback("mde_heuristic").version == "1"
    assert active(registry) == "1"
    with pytest.raises(RequestError, match="expected a version before the active one, got none"):
        registry.rollback("mde_heuristic")


def test_a_name_with_a_folder_has_its_own_versions(registry: Registry, tmp_path: Path):
    registry.add("narrow/mde_heuristic", write(tmp_path / "new", version="2", content=b"other"))
    registry.promote("narrow/mde_heuristic", "2")
    assert active(registry, "narrow/mde_heuristic") == "2"
    assert active(registry) == "1"
    assert registry.names() == ("mde_heuristic", "narrow/mde_heuristic")


def test_a_version_is_added_once_and_never_replaced(registry: Registry, tmp_path: Path):
    first = registry.add("mde_heuristic", write(tmp_path / "a", version="2", content=b"other"))
    assert registry.add("mde_heuristic", write(tmp_path / "b", version="2", content=b"other")).folder == first.folder
    with pytest.raises(RequestError, match="expected a new version, got '2', which has other weights"):
        registry.add("mde_heuristic", write(tmp_path / "c", version="2", content=b"third"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sha256": "0" * 64}, "expected SHA-256 0000"),
        ({"name": "mde_learned"}, "expected weights of mde_heuristic, got those of 'mde_learned'"),
        ({"version": "../2"}, "expected a version of letters"),
        ({"version": None}, "expected a card with name, version and sha256"),
    ],
)
def test_weights_that_are_not_what_their_card_says_are_refused(registry, tmp_path, change, message):
    folder = write(tmp_path / "new", version="2", content=b"other")
    (folder / CARD).write_text(json.dumps(json.loads((folder / CARD).read_text()) | change))
    with pytest.raises(RequestError, match=message):
        registry.add("mde_heuristic", folder)


def test_a_version_that_does_not_exist_is_refused(registry: Registry):
    with pytest.raises(RequestError, match="expected a version of 1, got '7'"):
        registry.promote("mde_heuristic", "7")


@pytest.mark.parametrize("name", ["../secrets", "a/b/c", "versions/mde_heuristic", ""])
def test_a_name_that_is_none_is_refused(registry: Registry, name: str):
    with pytest.raises(RequestError, match="expected a name of weights"):
        registry.folder(name)


def test_an_active_version_that_is_gone_is_told_of(registry: Registry, tmp_path: Path):
    added = registry.add("mde_heuristic", write(tmp_path / "new", version="2", content=b"other"))
    registry.promote("mde_heuristic", "2")
    (added.folder / CARD).unlink()
    with pytest.raises(RequestError, match="expected its active version '2'"):
        registry.folder("mde_heuristic")
    assert registry.rollback("mde_heuristic").version == "1"


def test_a_broken_list_of_promotions_is_told_of(registry: Registry, tmp_path: Path):
    path = tmp_path / "models" / VERSIONS / "mde_heuristic" / ACTIVE
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    with pytest.raises(RequestError, match="expected a list of promotions"):
        registry.folder("mde_heuristic")
