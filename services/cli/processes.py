"""Child processes of one machine: started together, watched, stopped together, none left behind."""

import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Self

GRACE_S = 6.0
MAX_RESTARTS = 5


@dataclass
class Child:
    """One ``frugal serve`` process; its standard input is a pipe that ends when its parent does."""

    name: str
    arguments: Sequence[str]
    environment: Mapping[str, str]
    log: IO[bytes] | None
    restarts: int = 0
    process: subprocess.Popen[bytes] | None = field(default=None, repr=False)

    def start(self) -> None:
        """Start the process; it stops by itself when this process ends, however that ends."""
        if self.process and self.process.stdin:
            self.process.stdin.close()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "services.cli.main", "serve", "--until-eof", *self.arguments],
            stdin=subprocess.PIPE,
            stdout=self.log,
            stderr=self.log,
            env=dict(self.environment),
            start_new_session=True,
        )


class Crew:
    """The processes of one system, as a context: leaving it stops them all.

    A signal from the terminal reaches this process only, so that the children stop in order: workers, then router.
    """

    def __init__(self, *, environment: Mapping[str, str], log_folder: Path | None = None) -> None:
        self._environment = environment
        self._log_folder = log_folder
        self._children: list[Child] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, *arguments: str, environment: Mapping[str, str] | None = None) -> None:
        """Start ``frugal serve <arguments>`` under a name of its own."""
        log: IO[bytes] | None = None
        if self._log_folder is not None:
            self._log_folder.mkdir(parents=True, exist_ok=True)
            log = (self._log_folder / f"{name}.log").open("wb")
        child = Child(name, arguments, {**self._environment, **(environment or {})}, log)
        self._children.append(child)
        child.start()

    def mend(self) -> list[str]:
        """Restart what has ended, at most `MAX_RESTARTS` times each, and return a sentence about each."""
        news: list[str] = []
        for child in self._children:
            code = child.process.poll() if child.process else None
            if code is None or child.restarts > MAX_RESTARTS:
                continue
            child.restarts += 1
            if child.restarts > MAX_RESTARTS:
                news.append(f"{child.name} ended with exit code {code} again; given up after {MAX_RESTARTS} restarts")
            else:
                news.append(f"{child.name} ended with exit code {code}; restarted")
                child.start()
        return news

    def ended(self) -> list[str]:
        """Return the names of the processes that are not running."""
        return [child.name for child in self._children if child.process is None or child.process.poll() is not None]

    def stop(self) -> None:
        """Stop the workers, then the first process, the router: ask, wait `GRACE_S` [s] at most, then kill."""
        for group in (self._children[1:], self._children[:1]):
            _stop(group)
        self._children.clear()


def _stop(children: Sequence[Child]) -> None:
    for child in children:
        if child.process and child.process.poll() is None:
            child.process.terminate()
    deadline = time.monotonic() + GRACE_S
    for child in children:
        if child.process:
            try:
                child.process.wait(max(deadline - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
            if child.process.stdin:
                child.process.stdin.close()
        if child.log:
            child.log.close()
