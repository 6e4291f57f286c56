"""One file per task, and the table of all of them."""

from common.domain.task import Task
from common.tasks.plating import Plating
from common.tasks.plating_yaw import PlatingYaw

TASKS: dict[str, Task] = {task.name: task for task in (Plating(), PlatingYaw())}
"""Name -> task."""
