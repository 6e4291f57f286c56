"""The simulator and the peers that are installed, on one scene in one run."""

import importlib
import importlib.util
import time
from collections.abc import Iterable
from dataclasses import asdict
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pipelines.bench.peer import Race, run_race
from pipelines.bench.peer_scene import PeerScene, make_peer_scene
from services.simulator.model import SimulatorModel

REPEATS = 5
"""Runs of the simulator of which the median counts; it takes a fraction of a second."""


def compare_peers() -> dict[str, object]:
    """Return times and agreement of the simulator and of every peer; None for a peer that is not installed.

    ``vbd_time_ratio`` is the wall time that Newton's VBD needs to come to rest, at the cheapest settings at which its
    mean item height agrees, over the simulator's wall time to rest. Where it does not come to rest within 1 s of
    simulated time it is the time of that second, a lower bound, and ``vbd_came_to_rest`` is False. The ratios called
    agreement stop the peer when its height first agrees and holds, which only who knows the answer can see.
    """
    scene = make_peer_scene()
    own, tops = run_own(scene)
    vbd = _newton(scene, tops)
    flex = _mujoco(scene, tops)
    return {
        **_ratios("vbd", vbd, own),
        **_ratios("flex", flex, own),
        "peers": {
            "simulator": own,
            "newton_vbd": [asdict(race) for race in vbd] if vbd else None,
            "mujoco_flex": [asdict(race) for race in flex] if flex else None,
        },
    }


def run_own(scene: PeerScene) -> tuple[dict[str, float], NDArray[np.float64]]:
    """Return the simulator's median times to rest [s] and the heights of the item's upper nodes ``(I, J)`` [m]."""
    placement = SimulatorModel().placement(scene.state)
    walls, cpus = [], []
    placed = placement.run(np.zeros((1, 2)))
    for _ in range(REPEATS):
        wall, cpu = time.perf_counter(), time.process_time()
        placed = placement.run(np.zeros((1, 2)))
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    tops = placed.outcome.nodes[0].astype(np.float64).reshape(scene.nodes.shape)[:, :, -1, 2]
    figures = {
        "wall_s": float(np.median(walls)),
        "cpu_s": float(np.median(cpus)),
        "settled": bool(placed.settled[0]),
        "simulated_s": float(placed.time[0]),
        "mean_height_m": float(tops.mean()),
    }
    return figures, tops


def _newton(scene: PeerScene, tops: NDArray[np.float64]) -> list[Race] | None:
    if importlib.util.find_spec("newton") is None:
        return None
    peer = importlib.import_module("pipelines.bench.peer_newton")
    return _first_that_agrees((partial(peer.NewtonPeer, scene, chosen) for chosen in peer.NEWTON_SETTINGS), tops)


def _mujoco(scene: PeerScene, tops: NDArray[np.float64]) -> list[Race] | None:
    if importlib.util.find_spec("mujoco") is None:
        return None
    peer = importlib.import_module("pipelines.bench.peer_mujoco")
    return _first_that_agrees((partial(peer.MujocoPeer, scene, chosen) for chosen in peer.MUJOCO_SETTINGS), tops)


def _first_that_agrees(makers: Iterable[partial], tops: NDArray[np.float64]) -> list[Race]:
    """Race from cheap to dear settings until one agrees; all races are kept."""
    races: list[Race] = []
    for make in makers:
        races.append(run_race(make(), tops))
        if races[-1].agrees:
            break
    return races


def _ratios(name: str, races: list[Race] | None, own: dict[str, float]) -> dict[str, float | bool | None]:
    race = races[-1] if races else None
    return {
        f"{name}_time_ratio": _over(race and race.end_wall_s, own["wall_s"]),
        f"{name}_came_to_rest": None if race is None else race.rest_wall_s is not None,
        f"{name}_agreement_ratio": _over(race and race.wall_s, own["wall_s"]),
        f"{name}_agreement_cpu_ratio": _over(race and race.cpu_s, own["cpu_s"]),
    }


def _over(seconds: float | None, own_s: float) -> float | None:
    return None if seconds is None else seconds / own_s
