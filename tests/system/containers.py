"""One Compose project of the tests, driven through the `docker` command."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


class ContainersError(AssertionError):
    """A `docker` command failed."""


@dataclass(frozen=True)
class Container:
    """One container of the project, as `docker compose ps --all` shows it."""

    id: str
    name: str
    service: str
    state: str
    health: str
    exit_code: int

    @property
    def is_well(self) -> bool:
        """Whether it is healthy, or was meant to end and did so with exit code 0."""
        return self.health == "healthy" if self.service != "warm" else (self.state, self.exit_code) == ("exited", 0)


@dataclass(frozen=True)
class Containers:
    """One Compose project; every command that fails says so with the logs of the services that are not well.

    Lease and timeouts are long, so that a busy machine that stalls for seconds fails no test.
    """

    project: str
    port: int

    def compose(self, *arguments: str, timeout_s: float = 300.0) -> str:
        """Run `docker compose` in this project and return its standard output."""
        done = self._run("docker", "compose", "--progress", "plain", *arguments, timeout_s=timeout_s)
        if done.returncode != 0:
            command = " ".join(arguments)
            tail = "\n".join(done.stderr.splitlines()[-60:])
            raise ContainersError(f"docker compose {command}: exit code {done.returncode}\n{tail}\n{self.report()}")
        return done.stdout

    def up(self, *arguments: str) -> None:
        """Start what is missing and wait until everything is healthy."""
        self.compose("up", "--detach", "--wait", "--wait-timeout", "300", *arguments, timeout_s=900)

    def remove(self) -> None:
        """Remove containers, networks, volumes and images of the project; the build cache stays."""
        self.compose("down", "--volumes", "--remove-orphans", "--rmi", "local")

    def list(self) -> list[Container]:
        """Return all containers of the project."""
        done = self._run("docker", "compose", "ps", "--all", "--format", "json", timeout_s=60)
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        return [
            Container(row["ID"], row["Name"], row["Service"], row["State"], row["Health"], row["ExitCode"])
            for row in rows
        ]

    def report(self, *, all_logs: bool = False) -> str:
        """Return the state of all services and the last words of those that are not well, or of all."""
        lines: list[str] = []
        for container in self.list():
            what = f"{container.state}, exit code {container.exit_code}, health: {container.health or 'none'}"
            lines.append(f"{container.name}: {what}")
            if all_logs or not container.is_well:
                logs = self._run("docker", "logs", "--tail", "40", container.id, timeout_s=60)
                probe = self._run("docker", "inspect", "--format", "{{json .State.Health}}", container.id, timeout_s=60)
                lines += [logs.stdout, logs.stderr, f"health checks: {probe.stdout[-1500:]}"]
        return "\n".join(lines)

    def wait_until(self, is_so: Callable[[], bool], *, timeout_s: float = 60.0) -> None:
        """Return once ``is_so`` is true."""
        deadline = time.monotonic() + timeout_s
        while not is_so():
            if time.monotonic() > deadline:
                raise ContainersError(f"not so after {timeout_s:g} s\n{self.report(all_logs=True)}")
            time.sleep(0.2)

    def docker(self, *arguments: str) -> str:
        """Run `docker` and return its standard output."""
        done = self._run("docker", *arguments, timeout_s=120)
        if done.returncode != 0:
            raise ContainersError(f"docker {' '.join(arguments)}: exit code {done.returncode}\n{done.stderr}")
        return done.stdout

    def frugal(self, *arguments: str) -> Any:
        """Run the command line outside the containers, over the published port, and return its JSON."""
        done = self._run(sys.executable, "-m", "services.cli.main", *arguments, "--json", timeout_s=300)
        if done.returncode != 0:
            command = " ".join(arguments)
            report = self.report(all_logs=True)
            raise ContainersError(f"frugal {command}: exit code {done.returncode}\n{done.stderr}\n{report}")
        return json.loads(done.stdout)

    def _run(self, *command: str, timeout_s: float) -> subprocess.CompletedProcess[str]:
        environment = {
            **os.environ,
            "COMPOSE_PROJECT_NAME": self.project,
            "FRUGAL_PORT": str(self.port),
            "FRUGAL_CONNECT": f"tcp/127.0.0.1:{self.port}",
            "FRUGAL_LEASE_S": "30",
            "FRUGAL_ORCHESTRATOR_PREDICT_TIMEOUT_S": "120",
        }
        return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout_s)
