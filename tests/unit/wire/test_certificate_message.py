"""Certificates and numbers in flight on the wire."""

from dataclasses import replace

import pytest

from common.wire.codec import decode, encode
from common.wire.optimization import OptimizeReply
from tests.unit.services.test_optimize_report import CERTIFICATE, RESULT


@pytest.mark.parametrize("form", ["msgpack", "json"])
@pytest.mark.parametrize("certificate", [CERTIFICATE, None])
def test_a_result_comes_back_as_it_was(form, certificate):
    result = replace(RESULT, certificate=certificate)
    message = OptimizeReply.of(result, request_id="a", task="plating", instance="o")
    found = decode(*encode(message, form=form), OptimizeReply).result()
    assert (found.certificate, found.in_flight) == (certificate, 2)


def test_replies_of_older_orchestrators_are_understood():
    old = OptimizeReply.of(RESULT, request_id="a", task="plating", instance="o").model_dump(
        exclude={"certificate", "in_flight"}
    )
    found = OptimizeReply.model_validate(old).result()
    assert (found.certificate, found.in_flight) == (None, 1)
