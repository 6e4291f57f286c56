"""The simulator's benchmark: its figures, its peers' scene and race, its memory."""

import json
import sys
from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipelines.bench.memory import measure_memory
from pipelines.bench.peer import AGREE, HOLD_S, Peer, run_race
from pipelines.bench.peer_scene import cut_into_tetrahedra, make_peer_scene
from pipelines.bench.peers import compare_peers
from pipelines.bench.placements import PlacementRecord, Settle
from pipelines.bench.summary import summarize


def a_record(*, rigid: bool = False, wall_s: float = 0.2, moved: float = 0.0, rms: float = 1e-4) -> PlacementRecord:
    runs = {name: Settle(wall_s, wall_s, True, moved, rms) for name in ("coarse", "default", "fine")}
    shifts = {name: Settle(wall_s, wall_s, True, moved, rms / 2) for name in ("10um", "100um", "1mm")}
    return PlacementRecord(0, rigid, 5e4, "default", 0.1, wall_s, wall_s, True, 1e-3, 2e-4, moved, runs, shifts)


def test_times_are_told_apart_by_stiffness_and_differences_by_whether_a_fry_moved():
    figures = summarize(
        [
            a_record(wall_s=0.2, rms=1e-4),
            a_record(wall_s=0.4, rms=3e-4),
            a_record(rigid=True, wall_s=0.05, rms=2e-3, moved=0.01),
        ]
    )
    assert figures["soft_median_s"] == pytest.approx(0.3)
    assert figures["rigid_median_s"] == 0.05
    assert figures["calm_scenes"] == 2
    assert figures["default_vs_fine_rms_median_m"] == pytest.approx(2e-4)
    assert figures["default_vs_fine_rms_median_all_m"] == pytest.approx(3e-4)
    assert figures["shift_100um_rms_median_m"] == pytest.approx(1e-4)
    assert figures["path_sensitivity_share"] == pytest.approx(0.25)


def test_a_scene_in_which_a_fry_moves_at_level_fine_alone_is_not_calm():
    record = a_record()
    record.levels["fine"] = Settle(1.0, 1.0, True, 0.02, 0.0)
    assert not record.calm


def test_what_moves_without_damping_or_never_came_to_rest_is_not_verified():
    still = a_record()
    creeping = PlacementRecord(1, False, 5e4, "default", 0.1, 0.2, 0.2, True, 0.01, 2e-4, 0.0)
    moving = PlacementRecord(2, False, 5e4, "default", 0.1, 0.2, 0.2, False, 0.001, 2e-4, 0.0)
    figures = summarize([still, creeping, moving])
    assert figures["settled_share"] == pytest.approx(2 / 3)
    assert figures["verified_share"] == pytest.approx(1 / 3)


def test_figures_of_nothing_are_none_and_can_be_written_as_json():
    figures = summarize([PlacementRecord(0, True, 1e9, "default", 0.1, 0.2, 0.2, True, 0.0, 0.0, 0.0)])
    assert figures["soft_median_s"] is None
    assert figures["default_vs_fine_rms_median_m"] is None
    assert figures["path_sensitivity_share"] is None
    json.dumps(figures, allow_nan=False)


class FallingPeer(Peer):
    """A plate of 2 x 2 x 2 nodes whose height follows a function of time."""

    name, step_s = "falling", 0.005

    def __init__(self, *heights: tuple[float, float]) -> None:
        self.settings = {}
        self._time = 0.0
        self._heights = np.array(heights).T

    def advance(self) -> None:
        self._time += self.step_s

    def nodes(self) -> NDArray[np.float64]:
        return np.full((2, 2, 2, 3), np.interp(self._time, *self._heights))


def test_a_peer_agrees_once_its_mean_height_has_stayed_near_and_it_rests():
    race = run_race(FallingPeer((0.0, 0.05), (0.2, 0.03)), np.full((2, 2), 0.03))
    assert race.agrees
    assert race.rest_wall_s is not None
    assert race.end_simulated_s == pytest.approx(0.2 + HOLD_S, abs=0.011)
    assert race.mean_difference_m == pytest.approx(0.0)


def test_a_peer_that_passes_the_answer_does_not_agree():
    race = run_race(FallingPeer((0.0, 0.05), (1.0, 0.01)), np.full((2, 2), 0.03))
    assert not race.agrees
    assert race.wall_s is None
    assert abs(race.mean_difference_m) > AGREE


def test_a_peer_that_trembles_near_the_answer_agrees_but_never_rests():
    shaking = [(0.05 * i, 0.03 + 4e-4 * (-1) ** i) for i in range(30)]
    race = run_race(FallingPeer(*shaking), np.full((2, 2), 0.03))
    assert race.agrees
    assert race.rest_wall_s is None
    assert race.end_speed > 3e-3


def test_tetrahedra_fill_the_item_and_share_their_faces():
    nodes = np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in (4, 3, 3)), indexing="ij"), axis=-1)
    tetrahedra = cut_into_tetrahedra(nodes)
    points = nodes.reshape(-1, 3)[tetrahedra]
    volumes = np.linalg.det(points[:, 1:] - points[:, :1]) / 6
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(3 * 2 * 2)
    faces = Counter(tuple(sorted(face)) for four in tetrahedra.tolist() for face in combinations(four, 3))
    outer = sum(1 for count in faces.values() if count == 1)
    assert max(faces.values()) == 2
    assert outer == 2 * 2 * (3 * 2 + 3 * 2 + 2 * 2)


def test_the_peers_scene_is_a_steak_above_nine_fries_at_rest():
    scene = make_peer_scene()
    assert len(scene.boxes) == 9
    assert scene.nodes[..., 2].min() > max(box.position[2] for box in scene.boxes)
    assert scene.volume == pytest.approx(0.141 * 0.090 * 0.020, rel=0.05)


def test_a_peer_that_is_not_installed_gives_none(monkeypatch: pytest.MonkeyPatch):
    for name in ("newton", "mujoco"):
        monkeypatch.setitem(sys.modules, name, None)
    found = compare_peers()
    assert found["vbd_time_ratio"] is None
    assert found["flex_time_ratio"] is None
    assert isinstance(found["peers"], dict)
    assert found["peers"]["simulator"]["settled"]
    assert found["peers"]["newton_vbd"] is None


def test_memory_is_measured_after_a_tenth_and_after_all_placements():
    found = measure_memory(10, seed=0, level="coarse", device="cpu")
    assert (found["placements_early"], found["placements"]) == (1, 10)
    assert found["ratio"] == pytest.approx(found["resident_bytes"] / found["resident_early_bytes"], abs=1e-4)
    assert found["resident_bytes"] > 50e6
