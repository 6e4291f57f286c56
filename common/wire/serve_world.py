"""A world as a worker, and behind the same front for those who ask it from afar."""

import numpy as np
import zenoh

from common.domain.grid import Floats
from common.domain.world import Sight, World
from common.wire.array import Array
from common.wire.call import Call
from common.wire.endpoint import Endpoint
from common.wire.host import Host
from common.wire.keys import Address
from common.wire.messages import Card, new_id
from common.wire.query import ask
from common.wire.world import ExecuteReply, ExecuteRequest, LookReply, LookRequest

EXECUTION_S = 60.0
"""Time that an action may take [s]."""


def host_world(session: zenoh.Session, world: World, *, task: str, instance: str | None = None) -> Host:
    """Return a worker with the endpoints ``look`` and ``execute``, one request at a time."""
    name = instance or new_id()[:8]

    def look(request: LookRequest, call: Call) -> LookReply:
        del call
        return LookReply.of(world.look(request.table), instance=name)

    def execute(request: ExecuteRequest, call: Call) -> ExecuteReply:
        del call
        after = world.execute(request.table, request.action)
        return ExecuteReply(after=Array.of(after.astype(np.float32)), instance=name)

    card = Card(task=task, role="world", model=None, instance=name, version=world.version)
    endpoints = [Endpoint("look", LookRequest, look), Endpoint("execute", ExecuteRequest, execute)]
    return Host(session, card, endpoints)


class RemoteWorld(World):
    """A world that another process serves.

    Args:
        session: The session to ask on.
        address: Where it is.

    Raises:
        UnavailableError: Nobody is there.
    """

    def __init__(self, session: zenoh.Session, address: Address) -> None:
        self._session = session
        self._address = address
        self.version = ask(session, address.key("card"), None, Card, timeout_s=EXECUTION_S).version

    def look(self, table: int) -> Sight:
        """Return what is seen of a table."""
        request = LookRequest(table=table)
        return ask(self._session, self._address.key("look"), request, LookReply, timeout_s=EXECUTION_S).sight()

    def execute(self, table: int, action: tuple[float, float]) -> Floats:
        """Return the depth image after an action [m]."""
        request = ExecuteRequest(table=table, action=action)
        reply = ask(self._session, self._address.key("execute"), request, ExecuteReply, timeout_s=EXECUTION_S)
        return reply.after.values()
