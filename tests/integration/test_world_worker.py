"""The world's stand-in as a process: it shows the same tables as in this process, and refuses what nobody can do."""

from pathlib import Path

import numpy as np
import pytest
from conftest import START_S

from common.domain.errors import RequestError
from common.wire.directory import Directory
from common.wire.serve_world import RemoteWorld
from common.wire.session import Session
from services.world.world import StandIn
from tests.fakes import serving


def test_a_served_world_shows_and_does_what_the_local_one_does(
    session: Session, directory: Directory, endpoint: str, tmp_path: Path
):
    local = StandIn()
    with serving("world", "--instance", "w", endpoint=endpoint, log=tmp_path / "log"):
        (worker,) = directory.wait_for("world", timeout_s=4 * START_S)
        world = RemoteWorld(session, worker.address)
        assert world.version == local.version
        seen, expected = world.look(4), local.look(4)
        for name in ("before", "item", "plate"):
            np.testing.assert_array_equal(getattr(seen, name), getattr(expected, name))
        np.testing.assert_allclose(seen.camera.rotation, expected.camera.rotation)
        assert seen.item_material == expected.item_material
        np.testing.assert_array_equal(world.execute(4, (0.01, -0.02)), local.execute(4, (0.01, -0.02)))
        with pytest.raises(RequestError, match=r"within 0\.1 m of the plate's centre, got \(0\.3, 0\.0\)"):
            world.execute(4, (0.3, 0.0))
