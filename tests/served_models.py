"""Models that tests serve with `frugal serve model`."""

from services.heuristic import HeuristicModel


class QuickSimulator(HeuristicModel):
    """Stands where the simulator would, as fast as the heuristic."""

    name = "simulator"
    version = "quick"
