"""Frames and cross-sections of one placement."""

from pathlib import Path

import numpy as np
import pytest

from common.domain.case import Case
from common.storage.cases import read_case
from pipelines.cross_sections import MODULI, sections_over_stiffness
from pipelines.figures_simulation import draw_sections
from pipelines.frames import place_with_frames
from pipelines.sections import boxes_of, cut
from services.simulator.model import SimulatorModel

SCENES = Path(__file__).parents[3] / "examples" / "scenes"


@pytest.fixture(scope="module", params=["04-medallion-bare", "03-rigid-heap"])
def case(request: pytest.FixtureRequest) -> Case:
    return read_case(SCENES / f"{request.param}.npz")


@pytest.fixture(scope="module")
def model() -> SimulatorModel:
    return SimulatorModel.at_level("coarse")


def test_frames_lead_in_time_to_the_outcome_that_the_model_predicts(case: Case, model: SimulatorModel):
    assert case.true_action is not None
    action = np.array(case.true_action)
    placed, frames = place_with_frames(model.placement(case.state), action, frames=6)
    times = [frame.time for frame in frames]
    assert 3 <= len(frames) <= 6
    assert times == sorted(set(times))
    assert np.array_equal(frames[-1].heights, model.predict(case.state, action[None]).heights[0])
    assert np.array_equal(frames[-1].heights, placed.heights[0])
    first, last = (frames[at].section.item[..., 1].mean() for at in (0, -1))
    assert last < first + 1e-5  # an item is lowered


def test_a_section_shows_the_item_above_the_plate_and_as_thick_as_it_is(case: Case, model: SimulatorModel):
    assert case.true_action is not None
    action = np.array(case.true_action)
    placement = model.placement(case.state)
    placed = placement.run(action[None])
    section = cut(placement, placed.outcome, action)
    thickness = np.linalg.norm(section.item[-1] - section.item[0], axis=1)
    assert np.median(thickness) == pytest.approx(np.median(case.state.item.heights[case.state.item.outline]), rel=0.1)
    ground = np.interp(section.item[0, :, 0], section.along, section.ground)
    assert (section.item[0, :, 1] - ground).min() > -1e-3
    assert np.abs(np.diff(section.item[0, :, 0])).max() < 1e-3


def test_boxes_of_an_outcome_are_as_many_as_the_scene_has_and_as_large(case: Case, model: SimulatorModel):
    placement = model.placement(case.state)
    placed = placement.run(np.zeros((1, 2)))
    found = boxes_of(placement, placed.outcome)
    assert [box.size.tolist() for box in found] == [box.size.tolist() for box in placement.boxes]


def test_the_stiffer_an_item_the_straighter_its_section():
    sections = sections_over_stiffness()
    assert [name for name, _ in sections][-1] == "rigid"
    bends = []
    for _, section in sections:
        along, height = section.item[-1].T
        bends.append(np.abs(height - np.polyval(np.polyfit(along, height, 1), along)).max())
    assert bends == sorted(bends, reverse=True)
    assert bends[0] > 2e-3
    assert bends[-1] < 1e-6
    assert len(draw_sections(sections, title="").axes) == len(MODULI)
