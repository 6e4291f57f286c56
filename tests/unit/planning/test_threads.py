"""Threads that nobody has to wait for."""

import subprocess
import sys
import threading
import time

import pytest

from common.planning.threads import Threads


def test_functions_run_at_the_same_time_and_their_results_and_errors_come_back():
    pool, barrier = Threads(2, name="test"), threading.Barrier(2, timeout=10)
    first, second = (pool.submit(lambda n: (barrier.wait(), n)[1], number) for number in range(2))
    assert (first.result(10), second.result(10)) == (0, 1)
    with pytest.raises(ZeroDivisionError):
        pool.submit(lambda: 1 / 0).result(10)
    pool.stop()


def test_what_waits_when_the_pool_stops_is_never_begun():
    pool, release, begun = Threads(1, name="test"), threading.Event(), threading.Event()

    def hang() -> None:
        begun.set()
        release.wait(10)

    running, waiting = pool.submit(hang), pool.submit(lambda: None)
    assert begun.wait(10)
    pool.stop()
    release.set()
    running.result(10)
    with pytest.raises(TimeoutError):
        waiting.result(0.1)


def test_a_function_that_hangs_does_not_keep_the_process_from_ending():
    code = (
        "import threading; from common.planning.threads import Threads; begun = threading.Event();"
        "Threads(1, name='x').submit(lambda: (begun.set(), threading.Event().wait(600))); begun.wait()"
    )
    began = time.monotonic()
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert time.monotonic() - began < 60
