import pytest
from pydantic import ValidationError

from common.wire.settings import WireSettings


def test_endpoints_in_the_environment_are_separated_by_commas(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FRUGAL_CONNECT", "tcp/a:7447, tcp/b:7447")
    assert WireSettings().connect == ("tcp/a:7447", "tcp/b:7447")


def test_by_default_the_router_is_on_this_machine(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("FRUGAL_CONNECT", raising=False)
    assert WireSettings().connect == ("tcp/127.0.0.1:7447",)


def test_no_endpoint_is_refused():
    with pytest.raises(ValidationError, match="connect"):
        WireSettings(connect=())


def test_settings_cannot_be_changed():
    with pytest.raises(ValidationError, match="frozen"):
        WireSettings().lease_s = 5.0  # type: ignore[misc]
