"""The learned model: the heuristic sum, corrected by a network in a window around the action."""

import threading
from collections import OrderedDict
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from common.domain.errors import ModelError, RequestError
from common.domain.grid import Floats
from common.domain.heightmap import shift
from common.domain.model import PredictiveModel
from common.domain.scene import State
from common.learning.features import HEIGHT_SCALE, transform
from common.learning.training import threads
from common.learning.weights import WeightsCard, load, read_card
from services.learned.network import NetworkSettings, ResidualNetwork
from services.learned.windows import Views

ARCHITECTURE = "residual-window-2"
QUIET = 3e-4
"""Corrections below this count as none: the answer is then the heuristic sum to the bit [m]."""

MIRROR = 4
"""The symmetry whose answer is averaged in; it is its own inverse."""

STATES = 16
"""States whose channels are kept."""


class LearnedModel(PredictiveModel):
    """Add to ``I_0 + shift(I_obj, a)`` what a residual encoder-decoder says in a window around the action.

    The network is asked about the window and about its mirror image, and the mean counts. Outside the window, and where
    nothing can move, the answer is the heuristic sum itself. An action is computed as if alone, on one thread, so that
    its answer does not depend on the batch. Threads may ask at once.

    Args:
        network: The trained network; its grid is the only one that the model takes.
        version: Version of model and weights.
        weights: SHA-256 of the file of weights, None if they come from none.
        bfloat16: Whether layers compute in bfloat16, as in training; None: where the processor does that itself.
    """

    name = "learned"

    def __init__(
        self, network: ResidualNetwork, *, version: str, weights: str | None = None, bfloat16: bool | None = None
    ) -> None:
        self.grid = network.grid
        self.weights = weights
        self.version = version
        self._network = network.to(memory_format=torch.channels_last).eval().requires_grad_(False)  # type: ignore[call-overload]
        able = bool(torch.cpu._is_avx512_bf16_supported())  # pyright: ignore[reportPrivateUsage]
        self._bfloat16 = able if bfloat16 is None else bfloat16
        self._views: OrderedDict[str, Views] = OrderedDict()
        self._lock = threading.Lock()

    @classmethod
    def load(cls, folder: Path) -> "LearnedModel":
        """Return the model with the weights in a folder.

        Raises:
            ModelError: There are none, or they are not what their card says.
        """
        card = read_card(folder, name=cls.name)
        grid = card.grid.grid()
        network = ResidualNetwork(network_settings(card, folder), grid)
        network.load_state_dict(load(folder, network.state_dict(), card=card))
        if network.grid != grid:
            raise ModelError(f"{folder}: expected a card with the grid of the weights, {network.grid}, got {grid}")
        return cls(network, version=card.version, weights=card.sha256)

    def outcomes(self, state: State, actions: NDArray[np.float64]) -> tuple[Floats, tuple[str, ...]]:
        """Return the predicted heightmaps ``(B, H, W)`` [m].

        Raises:
            RequestError: The state is on another grid than the training data.
        """
        if state.grid != self.grid:
            raise RequestError(f"grid: expected {self.grid} as in the training data, got {state.grid}")
        views = self._seen(state)
        narrow = torch.autocast("cpu", torch.bfloat16, enabled=self._bfloat16)
        with torch.inference_mode(), threads(1), narrow:
            predicted = np.stack([self._outcome(state, views, action) for action in actions])
        return predicted, ("",) * len(actions)

    def _outcome(self, state: State, views: Views, action: NDArray[np.float64]) -> NDArray[np.float32]:
        heights = state.scene.heights + shift(state.item.heights, *(action / self.grid.cell))
        size = self._network.settings.window
        inputs, firsts = views.inputs(action[None], self.grid, size)
        mirrored = torch.cat([inputs, transform(inputs, MIRROR)]).contiguous(memory_format=torch.channels_last)
        one, other = self._network(mirrored)
        residual = ((one + transform(other, MIRROR)) / 2).float().numpy()
        first = firsts[0, ::-1]  # row, column
        start, stop = np.maximum(first, 0), np.minimum(first + size, self.grid.shape)
        if (start < stop).all():
            seen = residual[tuple(slice(a - f, b - f) for a, b, f in zip(start, stop, first, strict=True))]
            there = tuple(slice(a, b) for a, b in zip(start, stop, strict=True))
            correction = np.float32(HEIGHT_SCALE) * seen
            corrected = np.maximum(heights[there] + correction, state.scene.heights.min())
            heights[there] = np.where(np.abs(correction) < QUIET, heights[there], corrected)
        return heights

    def _seen(self, state: State) -> Views:
        """Return what the network sees of the state alone, computed once and kept for the last few states."""
        with self._lock:
            if state.digest not in self._views:
                scene, item = state.scene, state.item
                arrays = scene.heights, scene.materials, item.heights, item.materials
                self._views[state.digest] = Views.of(*(array[None] for array in arrays))
            self._views.move_to_end(state.digest)
            while len(self._views) > STATES:
                self._views.popitem(last=False)
            return self._views[state.digest]


def network_settings(card: WeightsCard, folder: Path) -> NetworkSettings:
    """Return the network's size from the card of its weights.

    Raises:
        ModelError: The card is of another network, or its sizes make none.
    """
    if card.architecture != ARCHITECTURE:
        raise ModelError(f"{folder}: expected a network of the architecture {ARCHITECTURE}, got {card.architecture!r}")
    found: Any = card.settings.get("network")
    expected = {name: type(value) for name, value in asdict(NetworkSettings()).items()}
    if not isinstance(found, dict) or found.keys() != expected.keys():
        raise ModelError(f"{folder}: expected the network's settings {sorted(expected)}, got {found!r:.200}")
    try:
        return NetworkSettings(**{**found, "widths": tuple(found["widths"])})
    except (TypeError, ValueError) as error:
        raise ModelError(f"{folder}: {error}, got {found!r:.200}") from None
