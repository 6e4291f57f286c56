"""A worker's counters as OpenMetrics text, for people and monitoring."""

from common.wire.keys import Address
from common.wire.messages import Health

ENCODING = "application/openmetrics-text"


def exposition(address: Address, health: Health) -> str:
    """Return the text of a worker's metrics."""
    worker = f'task="{address.task}",role="{address.role}",model="{address.model or ""}",instance="{address.instance}"'
    lines: list[str] = []
    for name, kind, value in (
        ("served", "counter", health.served),
        ("failed", "counter", health.failed),
        ("refused", "counter", health.refused),
        ("queue_length", "gauge", health.queue_length),
        ("in_progress", "gauge", health.in_progress),
        ("uptime_seconds", "gauge", health.uptime_s),
    ):
        sample = f"frugal_{name}_total" if kind == "counter" else f"frugal_{name}"
        lines += [f"# TYPE frugal_{name} {kind}", f"{sample}{{{worker}}} {value:g}"]
    lines.append("# TYPE frugal_compute_seconds gauge")
    lines += [f'frugal_compute_seconds{{{worker},batch="{cost.batch}"}} {cost.p50_s:g}' for cost in health.cost]
    return "\n".join([*lines, "# EOF", ""])
