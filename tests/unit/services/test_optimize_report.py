"""What `frugal optimize` tells a person and writes for a program."""

from dataclasses import replace

import numpy as np

from common.domain.case import Case
from common.domain.certificate import Certificate
from common.domain.trial import Result, Trial
from common.storage.results import summarize
from services.cli.optimize import make_request, report
from tests.fakes import make_state

STATE = make_state()
TRIAL = Trial(0, (0.01, 0.02), "simulator", "a", "1", -3e-4)
RESULT = Result(
    (0.01, 0.02),
    -3e-4,
    STATE.scene.heights,
    (TRIAL,),
    {"simulator": 1},
    {"simulator": "1"},
    {},
    0.1,
    (),
    "quality",
    0,
    2,
)
CASE = Case("case", 0, STATE, STATE.scene.heights, (0.01, 0.02), True)
CERTIFICATE = Certificate(8.1e-5, 0.9, 113, 0.25)


def test_a_certificate_is_a_sentence_for_a_person_and_fields_for_a_program():
    certified = replace(RESULT, certificate=CERTIFICATE)
    assert "no other of 113 actions is better by more than 0.081 mm (probability 0.9); 25% of" in "\n".join(
        report(CASE, certified)
    )
    assert summarize(certified, case=CASE, settings={})["certificate"] == {
        "gain": 8.1e-5,
        "probability": 0.9,
        "actions": 113,
        "left": 0.25,
    }


def test_without_a_certificate_nothing_is_claimed():
    assert not any("no other" in line for line in report(CASE, RESULT))
    summary = summarize(RESULT, case=CASE, settings={})
    assert summary["certificate"] is None
    assert summary["in_flight"] == 2


def test_a_request_leaves_the_number_in_flight_to_the_system_unless_it_is_given():
    assert make_request(CASE).in_flight is None
    assert make_request(CASE, in_flight=3).in_flight == 3
    assert np.shape(make_request(CASE).target.values()) == STATE.grid.shape
