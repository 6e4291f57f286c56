import json
import shutil

import numpy as np
import pytest
import zarr
from dataset_fakes import GRID, Restless, contents, made, plan, same, write

from common.domain.case import Case
from common.domain.errors import RequestError
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.storage.dataset import Dataset
from common.storage.dataset_cases import samples_of_cases


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of a complete data set; copy it before it is spoilt."""
    path = tmp_path_factory.mktemp("data") / "small"
    write(path)
    return path


@pytest.fixture
def copy(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "copy")


def test_samples_come_back_as_they_were_made(whole):
    samples = Dataset.open(whole).samples("train")
    states = [made("train", index) for index in range(3)]
    assert len(samples) == 5
    assert samples.groups.tolist() == [0, 0, 1, 1, 2]
    for row, (index, place) in enumerate([(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)]):
        found = states[index]
        assert same(samples.scene_heights[row], found.state.scene.heights)
        assert same(samples.scene_materials[row], found.state.scene.materials)
        assert same(samples.item_heights[row], found.state.item.heights)
        assert same(samples.item_materials[row], found.state.item.materials)
        assert same(samples.actions[row], found.actions[place])
        assert same(samples.outcomes[row], found.outcomes[place])
        assert samples.places[row] == found.places[place]
        assert (samples.kinds[row], samples.layouts[row]) == (found.kind, found.layout)
        assert samples.rigid[row] == found.state.item.is_rigid


def test_a_state_comes_back_with_its_bodies_and_its_digest(whole):
    dataset = Dataset.open(whole)
    for split, count in (("train", 3), ("test", 1)):
        for index in range(count):
            state, first = dataset.state(split, index), made(split, index).state
            assert state.digest == first.digest
            assert len(state.scene.bodies.boxes) == len(first.scene.bodies.boxes) > 0


def test_train_and_test_share_no_state(whole):
    dataset = Dataset.open(whole)
    assert dataset.state("train", 0).digest != dataset.state("test", 0).digest


def test_the_card_tells_what_is_in_the_set(whole):
    card = Dataset.open(whole).card
    samples = Dataset.open(whole).samples("train")
    assert (card.name, card.seed, card.version, card.counts) == ("small", 3, "1", {"train": 5, "test": 2})
    assert card.states == {"train": 3, "test": 1}
    assert card.failed == {"train": {}, "test": {}}
    assert card.grid.grid() == GRID
    assert card.deviation_scale_m is None
    modulus = samples.item_materials[:, 1]
    assert card.ranges["item_youngs_modulus"] == (modulus[modulus > 0].min(), modulus.max())
    assert card.ranges["action_x"] == (samples.actions[:, 0].min(), samples.actions[:, 0].max())
    assert card.ranges["outcome_height"] == (samples.outcomes.min(), samples.outcomes.max())


def test_failed_samples_are_kept_with_their_reason_and_left_out_unless_asked_for(tmp_path):
    dataset = write(tmp_path / "set", model=Restless())
    samples, everything = dataset.samples("train"), dataset.samples("train", include_failed=True)
    assert len(samples) == dataset.card.counts["train"] == 5
    assert samples.warnings == [""] * 5
    assert (samples.actions[:, 0] >= 0).all()
    reasons = [warning.split(":")[0] for warning in everything.warnings if warning]
    assert dataset.card.failed["train"] == {name: reasons.count(name) for name in sorted(set(reasons))}
    assert set(reasons) == {"not_settled", "model"}
    for warning, outcome in zip(everything.warnings, everything.outcomes, strict=True):
        assert (
            np.isnan(outcome).all() if warning.startswith("model: the solver diverged") else np.isfinite(outcome).all()
        )


def test_an_unknown_split_or_state_is_refused(whole):
    dataset = Dataset.open(whole)
    with pytest.raises(RequestError, match="expected a split of train, test, got 'validation'"):
        dataset.samples("validation")
    with pytest.raises(RequestError, match="expected a state from 0 to 2 of train, got 3"):
        dataset.state("train", 3)


def test_a_deviation_scale_is_fixed_once(copy):
    dataset = Dataset.open(copy)
    dataset.fix_deviation_scale(0.004)
    dataset.fix_deviation_scale(0.004)
    assert Dataset.open(copy).card.deviation_scale_m == 0.004
    with pytest.raises(RequestError, match=r"expected to keep the deviation scale of 0.004 m, got 0.005 m"):
        Dataset.open(copy).fix_deviation_scale(0.005)
    with pytest.raises(RequestError, match="expected a deviation scale above 0"):
        dataset.fix_deviation_scale(float("nan"))


def _remove(name):
    return lambda path: (path / name).unlink()


def _damage(name):
    def spoil(path):
        content = bytearray((path / name).read_bytes())
        content[len(content) // 2] ^= 0xFF
        (path / name).write_bytes(bytes(content))

    return spoil


def _card(**changes):
    def spoil(path):
        card = json.loads((path / "card.json").read_text()) | changes
        (path / "card.json").write_text(json.dumps(card))

    return spoil


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_remove("train/outcomes/c/1/0/0"), "outcomes: expected numbers for every sample, got none for 2 of 5"),
        (_remove("train/item_heights/c/0/0/0"), "item_heights: expected numbers for every sample, got none for 2 of 5"),
        (_damage("train/scene_heights/c/1/0/0"), "scene_heights: expected intact chunks, got a damaged one"),
        (_damage("train/states.jsonl"), "expected the SHA-256 on the card"),
        (_remove("train/states.jsonl"), "expected the states of train in"),
        (_remove("train/actions/zarr.json"), "expected a Zarr array at"),
        (_damage("train/actions/zarr.json"), "expected a Zarr array"),
        (lambda path: zarr.open_array(path / "train/outcomes", mode="r+").resize((4, 48, 50)), "expected an array of"),
        (_remove("card.json"), "run its `frugal data generate` again"),
        (lambda path: (path / "card.json").write_text("{"), "expected JSON"),
        (_card(format="frugal-dataset-0"), "expected the format frugal-dataset-1, got 'frugal-dataset-0'"),
        (_card(states={"train": 4, "test": 1}), "expected the states 0 to 3, got 3 others"),
        (_card(actions_per_state=3), "expected an array of shape"),
        (_card(secret=1), "secret: Extra inputs are not permitted"),
        (_card(seed="many"), "seed: Input should be a valid integer"),
    ],
)
def test_a_spoilt_set_is_refused_and_the_error_names_the_place(copy, spoil, message):
    spoil(copy)
    with pytest.raises(RequestError, match=message) as caught:
        Dataset.open(copy).samples("train")
    assert str(copy) in str(caught.value)


def test_a_state_that_was_changed_is_refused(copy):
    array = zarr.open_array(copy / "train" / "item_heights", mode="r+")
    values = np.asarray(array[1])
    values[values > 0] *= np.float32(1.01)
    array[1] = values
    with pytest.raises(RequestError, match="expected state 1 of train with the digest"):
        Dataset.open(copy).state("train", 1)


@pytest.mark.parametrize("there", [(), ("notes.txt",)])
def test_a_folder_of_something_else_is_refused(tmp_path, there):
    for name in there:
        (tmp_path / name).write_text("hello")
    with pytest.raises(RequestError, match=r"expected a data set \(frugal-dataset-1\) in .*, got none"):
        Dataset.open(tmp_path)


def test_every_preset_can_be_read_on_every_grid(tmp_path):
    for number, preset in enumerate(("wide", "narrow")):
        of = plan(preset=preset, grid={"rows": 64, "columns": 64, "cell": 0.0045}, counts={"train": 2, "test": 1})
        samples = write(tmp_path / str(number), of=of).samples("train")
        assert samples.outcomes.shape == (2, 64, 64)


def test_the_narrow_preset_has_one_soft_steak_in_many_scenes(tmp_path):
    of = plan(preset="narrow", counts={"train": 6, "test": 1}, actions_per_state=1)
    samples = write(tmp_path / "set", of=of).samples("train")
    assert (samples.item_heights == samples.item_heights[0]).all()
    assert (samples.item_materials == samples.item_materials[0]).all()
    assert not samples.rigid.any()
    assert len(np.unique(samples.scene_heights, axis=0)) == 6


def test_writing_the_same_set_twice_gives_the_same_bytes(whole, tmp_path):
    write(tmp_path / "again")
    assert contents(tmp_path / "again") == contents(whole)


def a_case(**changes):
    state = made("train", 0).state
    values = {"name": "one", "seed": 0, "state": state, "target": state.scene.heights, "true_action": (0.01, 0.02)}
    return Case(**(values | {"same_item": True} | changes))


def test_own_trials_become_samples():
    other = made("train", 1).state
    samples = samples_of_cases([a_case(), a_case(state=other, target=other.scene.heights, true_action=(0.0, 0.0))])
    assert same(samples.item_heights[1], other.item.heights)
    assert samples.actions.tolist() == [[0.01, 0.02], [0.0, 0.0]]
    assert samples.groups.tolist() == [0, 1]


def test_trials_without_an_action_or_on_another_grid_are_refused():
    small = Grid(40, 40, 0.006)
    plate, item = np.zeros(small.shape, np.float32), np.zeros(small.shape, np.float32)
    item[10:20, 10:20] = 0.01
    masks = np.array([1e3, 1e5, 0.3], np.float32)[:, None, None] * (item > 0)
    state = State(Scene(small, plate, np.zeros((3, *small.shape), np.float32)), Item(item, masks))
    with pytest.raises(RequestError, match="one: expected a case with its own item's action"):
        samples_of_cases([a_case(same_item=False)])
    with pytest.raises(RequestError, match="other: expected Grid"):
        samples_of_cases([a_case(), a_case(name="other", state=state, target=plate)])
    with pytest.raises(RequestError, match="expected at least one case"):
        samples_of_cases([])
