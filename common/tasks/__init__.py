"""One file per task, and the table of all of them."""

from common.domain.task import Task
from common.tasks.plating import Plating

TASKS: dict[str, Task] = {task.name: task for task in (Plating(),)}
"""Name -> task."""
