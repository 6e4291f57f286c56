"""The members of an ensemble, computed together."""

import numpy as np
import pytest
import torch

from common.domain.grid import Grid
from common.learning.training import seeded
from services.mde.ensemble import Ensemble, Inference
from services.mde.network_crop import CropNetwork

GRID = Grid(64, 72, 0.0045)


@pytest.fixture(scope="module")
def ensemble() -> Ensemble:
    with seeded(0):
        members = [CropNetwork(GRID, channels=(8, 8, 12, 16), features=8).eval() for _ in range(3)]
        made = Ensemble(list(members)).requires_grad_(False)
        for member in members:  # normalisations begin as 1 and 0, which would hide a mix-up
            for layer in (*member.joint, *member.scene, *member.item):
                if isinstance(layer, torch.nn.GroupNorm):
                    torch.nn.init.normal_(layer.weight)
                    torch.nn.init.normal_(layer.bias)
        made.means.normal_()
        made.whitenings.normal_()
        made.limits.uniform_(1.0, 2.0)
    return made


@pytest.mark.parametrize("count", [1, 5])
@torch.inference_mode()
def test_together_they_say_what_they_say_in_turn(ensemble: Ensemble, count: int):
    with seeded(1):
        scene, item = torch.rand(1, 5, 32, 36), torch.rand(1, 5, 32, 36)
    # Some windows leave the scene on every side.
    actions = np.random.default_rng(2).uniform(-0.08, 0.08, (count, 2))
    in_turn = [part.mean(dim=0).numpy() for part in ensemble.estimate(ensemble.encode(scene, item), actions)]
    inference = Inference(ensemble)
    together = inference.estimate(inference.encode(scene, item), actions)
    for found, expected in zip((together.median, together.gap, together.distance), in_turn, strict=True):
        assert found.shape == (count,)
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)
