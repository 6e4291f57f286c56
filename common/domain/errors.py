"""Errors, split by whose fault they are. Every message says what was expected and what came."""


class FrugalError(Exception):
    """The root of all errors that this project raises on purpose."""

    code = "error"


class RequestError(FrugalError):
    """The caller's fault: the same request will fail everywhere, so it is never retried."""

    code = "request"


class UnknownStateError(RequestError):
    """A request named a state by its digest and the worker does not hold it: send the state itself."""

    code = "unknown_state"


class ModelError(FrugalError):
    """The model's or the estimator's fault: it raised, or it returned something of the wrong shape."""

    code = "model"


class UnavailableError(FrugalError):
    """Nobody can serve the request now: no worker is alive, or all of them are gone."""

    code = "unavailable"


class BusyError(UnavailableError):
    """The worker's queue is full: ask another, then back off."""

    code = "busy"


class TimedOutError(FrugalError):
    """The time budget of a call ended before its answer came."""

    code = "timed_out"


class ExpiredError(TimedOutError):
    """The worker reached a request after its budget had ended, and did not compute it."""

    code = "expired"


class CancelledError(FrugalError):
    """The caller took the request back."""

    code = "cancelled"


ERRORS: dict[str, type[FrugalError]] = {
    error.code: error
    for error in (
        RequestError,
        UnknownStateError,
        ModelError,
        UnavailableError,
        BusyError,
        TimedOutError,
        ExpiredError,
        CancelledError,
    )
}
"""Code on the wire -> error class."""
