"""One small message of every kind, for the recorded examples of the public contract."""

import numpy as np
from pydantic import BaseModel

from common.domain.bodies import Bodies, Box, Material, Plate
from common.domain.camera import Camera
from common.domain.grid import Grid
from common.domain.scene import Item, Scene, State
from common.domain.world import Sight
from common.wire.array import Array
from common.wire.messages import (
    CancelReply,
    Card,
    Cost,
    ErrorReply,
    EstimateReply,
    EstimateRequest,
    Health,
    LoadReply,
    LoadRequest,
    PredictReply,
    PredictRequest,
)
from common.wire.optimization import EventMessage, OptimizeReply, OptimizeRequest, Progress, TrialMessage
from common.wire.report import TrialReply, TrialReport
from common.wire.state import GridMessage, StateMessage
from common.wire.world import ExecuteReply, ExecuteRequest, LookReply, LookRequest

SMALL, SERVABLE = Grid(4, 6, 0.01), Grid(16, 16, 0.01)


def example_state(grid: Grid = SMALL) -> State:
    """Return a state with a known plate and one known fry."""
    x, y = grid.x[None, :], grid.y[:, None]
    heights = np.where((abs(x + 0.005) < 0.015) & (abs(y + 0.005) < 0.006), 0.012, 0.0).astype(np.float32)
    item = np.where((abs(x) < 0.01) & (abs(y) < 0.01), 0.015, 0.0).astype(np.float32)
    scene_materials, item_materials = np.zeros((2, 3, *grid.shape), dtype=np.float32)
    scene_materials[:, heights > 0] = np.array([[600.0], [2e6], [0.3]])
    item_materials[:, item > 0] = np.array([[1050.0], [1e5], [0.45]])
    fry = Box(
        np.array([0.03, 0.012, 0.012]),
        np.array([-0.005, -0.005, 0.006]),
        np.array([0.0, 0.0, 0.0, 1.0]),
        Material(600.0, 2e6, 0.3),
    )
    plate = Plate(np.array([0.0, 0.08, 0.12]), np.array([0.0, 0.0, 0.02]))
    return State(Scene(grid, heights, scene_materials, Bodies(plate, (fry,))), Item(item, item_materials))


def example_optimization() -> OptimizeRequest:
    """Return a request that a system with the heuristic model serves: the item one cell to the right and below."""
    state = example_state(SERVABLE)
    target = state.scene.heights + np.roll(state.item.heights, (-1, 1), axis=(0, 1))
    return OptimizeRequest(
        id="request-3",
        state=StateMessage.of(state),
        target=Array.of(target),
        bounds=((-0.04, 0.04), (-0.03, 0.03)),
        strategy="only:heuristic",
        evaluations=30,
    )


def example_sight() -> Sight:
    """Return what a camera of 3 x 2 pixels sees, half a metre above the plate."""
    depth = np.array([[0.5, 0.49, 0.0], [0.5, 0.5, 0.5]], dtype=np.float32)
    camera = Camera(4.0, 4.0, 1.0, 0.5, np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.5]))
    return Sight(depth, depth, None, camera, Material(1050.0, 3e4, 0.4), Material(550.0, 1e6, 0.3), "rump")


def example_report() -> TrialReport:
    """Return a report that a recorder takes: the item one cell to the right and below, on what lies there."""
    state = example_state(SERVABLE)
    outcome = state.scene.heights + np.roll(state.item.heights, (-1, 1), axis=(0, 1))
    return TrialReport(
        id="trial-1",
        robot="arm-1",
        state=StateMessage.of(state),
        action=(0.01, -0.01),
        outcome=Array.of(outcome),
        notes="gripper slipped a little",
    )


def example_messages() -> tuple[BaseModel, ...]:
    """Return one message of every kind that travels by itself."""
    state = example_state()
    content, actions = StateMessage.of(state), Array.of(np.array([[0.01, -0.005], [0.0, 0.0]]))
    outcome = state.scene.heights + state.item.heights
    estimates = np.array([0.12, 0.55])
    trial = TrialMessage(
        index=0,
        action=(0.01, -0.005),
        model="simulator",
        instance="a1b2",
        version="1",
        reward=-0.0004,
        estimates={"heuristic": 0.55},
        warning="not_settled: 4 mm/s",
        started_s=0.01,
        predict_s=0.52,
        compute_s=0.5,
    )
    event = EventMessage(kind="no_reply", worker="simulator/c3d4", detail="no reply: its process stopped", time=1.5)
    cost = (Cost(batch=1, p50_s=0.5, count=12),)
    return (
        PredictRequest(id="request-1", state=state.digest, content=content, actions=actions),
        PredictReply(
            heights=Array.of(np.stack([outcome, outcome])),
            warnings=("", "not_settled: 4 mm/s"),
            model="simulator",
            version="1",
            instance="a1b2",
            compute_s=0.5,
        ),
        EstimateRequest(id="request-2", state=state.digest, actions=actions),
        EstimateReply(
            mean=Array.of(estimates),
            upper=Array.of(np.minimum(1.5 * estimates, 1.0)),
            familiar=Array.of(np.array([True, False])),
            model="heuristic",
            version="1",
            instance="e5f6",
            compute_s=0.004,
        ),
        LoadRequest(id="request-6", card=b'{"name": "mde_heuristic"}', tensors=b"\x00\x01"),
        LoadReply(model="heuristic", version="1-s2r", previous="1", weights="0" * 64, instance="e5f6"),
        example_optimization(),
        OptimizeReply(
            id="request-3",
            task="plating",
            action=(0.01, -0.005),
            reward=-0.0004,
            heights=Array.of(outcome),
            trials=(trial,),
            usage={"simulator": 1},
            models={"simulator": "1"},
            split_s={"simulator": 0.5, "mde": 0.004, "optimiser": 0.003, "transport": 0.002},
            wall_s=0.53,
            events=(event,),
            strategy="threshold",
            seed=0,
            instance="0a0b",
        ),
        Progress(kind="trial", id="request-3", index=1, time=0.53, trial=trial),
        example_report(),
        TrialReply(
            id="trial-1",
            task="plating",
            robot="arm-1",
            digest="0" * 64,
            number=1,
            file=f"000001-arm-1-{'0' * 12}.npz",
        ),
        Card(
            task="plating",
            role="model",
            model="simulator",
            instance="a1b2",
            version="1",
            weights="0" * 64,
            device="cpu",
            grid=GridMessage.of(SMALL),
            largest_batch=64,
            cost=cost,
        ),
        Health(
            status="ok",
            queue_length=1,
            in_progress=1,
            computing_s=0.25,
            served=12,
            failed=1,
            refused=2,
            uptime_s=60.0,
            cost=cost,
        ),
        LookRequest(id="request-4", table=7),
        LookReply.of(example_sight(), instance="9a8b"),
        ExecuteRequest(id="request-5", table=7, action=(0.01, -0.005)),
        ExecuteReply(after=Array.of(np.full((2, 3), 0.48, dtype=np.float32)), instance="9a8b"),
        CancelReply(id="request-3", found=True),
        ErrorReply(code="request", message="evaluations: expected greater than or equal to 1, got 0"),
    )
