"""Versions of weights on disk."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from common.domain.errors import RequestError, UnavailableError
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


def test_versions_are_listed_without_an_active_one_if_that_is_gone(registry: Registry, tmp_path: Path):
    registry.add("mde_heuristic", write(tmp_path / "a", version="2", content=b"other"))
    gone = registry.add("mde_heuristic", write(tmp_path / "b", version="3", content=b"third"))
    registry.promote("mde_heuristic", "3")
    (gone.folder / CARD).unlink()
    assert [(one.version, one.is_active) for one in registry.versions("mde_heuristic")] == [("1", False), ("2", False)]


def test_the_last_rollback_leads_to_the_released_version_whichever_it_is_by_then(registry: Registry, tmp_path: Path):
    registry.add("mde_heuristic", write(tmp_path / "new", version="2", content=b"other"))
    registry.promote("mde_heuristic", "2")
    shutil.rmtree(tmp_path / "models" / "mde_heuristic")
    write(tmp_path / "models" / "mde_heuristic", version="1.1", content=b"released since")
    assert registry.rollback("mde_heuristic").version == active(registry) == "1.1"


def test_rollbacks_go_back_one_promotion_at_a_time(registry: Registry, tmp_path: Path):
    for version in ("2", "3"):
        registry.add("mde_heuristic", write(tmp_path / version, version=version, content=version.encode()))
    for version in ("2", "3", "3", "1"):
        registry.promote("mde_heuristic", version)
    assert [registry.rollback("mde_heuristic").version for _ in range(3)] == ["3", "2", "1"]


def test_versions_of_what_was_never_released_are_promoted_and_not_rolled_back(registry: Registry, tmp_path: Path):
    registry.add("mde_simulator", write(tmp_path / "new", version="1-s2r", name="mde_simulator"))
    assert [one.is_active for one in registry.versions("mde_simulator")] == [False]
    registry.promote("mde_simulator", "1-s2r")
    assert active(registry, "mde_simulator") == "1-s2r"
    with pytest.raises(RequestError, match="expected a version before the active one, got none"):
        registry.rollback("mde_simulator")
    assert active(registry, "mde_simulator") == "1-s2r"


def test_a_version_is_removed_unless_it_is_active_or_released(registry: Registry, tmp_path: Path):
    for version in ("2", "3"):
        registry.add("mde_heuristic", write(tmp_path / version, version=version, content=version.encode()))
    registry.promote("mde_heuristic", "3")
    for version in ("1", "2", "3", "../../../2"):
        registry.remove("mde_heuristic", version)
    assert [one.version for one in registry.versions("mde_heuristic")] == ["1", "3"]
    assert (tmp_path / "2" / CARD).is_file()


def test_one_process_at_a_time_changes_versions(registry: Registry):
    with registry.turn(), pytest.raises(UnavailableError, match="expected nobody else"), registry.turn():
        pass
    with registry.turn():
        assert registry.names() == ("mde_heuristic", "narrow/mde_heuristic")


def test_a_folder_of_weights_that_is_not_there_is_told_of_and_not_made(tmp_path: Path):
    with pytest.raises(RequestError, match="expected a folder of weights"), Registry(tmp_path / "modles").turn():
        pass
    assert not (tmp_path / "modles").exists()


def test_an_interrupted_write_leaves_what_was_active(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    registry.add("mde_heuristic", write(tmp_path / "new", version="2", content=b"other"))
    registry.promote("mde_heuristic", "2")

    def full(path: Path, text: str) -> int:
        path.write_bytes(text.encode()[:10])
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        registry.rollback("mde_heuristic")
    assert active(registry) == "2"


def test_a_broken_list_of_promotions_is_told_of(registry: Registry, tmp_path: Path):
    path = tmp_path / "models" / VERSIONS / "mde_heuristic" / ACTIVE
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    with pytest.raises(RequestError, match="expected a list of promotions"):
        registry.folder("mde_heuristic")
