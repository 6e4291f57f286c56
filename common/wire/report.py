"""Messages between a robot and the recorder: an action that was executed, and where its outcome is kept."""

from typing import Annotated

from pydantic import Field

from common.wire.array import Array
from common.wire.messages import Digest, Name, Reply, Request
from common.wire.state import StateMessage

LONGEST_NOTES = 1000


class TrialReport(Request):
    """Reports an action that a robot executed. The same ``id`` and content again get the same answer again."""

    robot: Name | None = Field(default=None, description="Who executed it; null: whom the key names.")
    state: StateMessage = Field(description="Scene and item before the action.")
    action: Annotated[tuple[float, ...], Field(min_length=1, max_length=16)] = Field(
        description="The parameters of the executed action, (x, y) [m] for plating, for plating_yaw also yaw [rad]."
    )
    outcome: Array = Field(description="The surface (H, W) after the action, on the state's grid [m].")
    notes: str = Field(default="", max_length=LONGEST_NOTES, description="Anything worth knowing later.")


class TrialReply(Reply):
    """Where a trial is kept. It is on disk before this is sent."""

    id: str = Field(description="The report's.")
    task: str
    robot: str
    digest: Digest = Field(description="SHA-256 of state, action and outcome.")
    number: int = Field(ge=1, description="Its place in the record, in the order of recording.")
    file: str = Field(description="Name of its case file in the recorder's folder.")
