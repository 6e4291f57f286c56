"""The variants of the networks by name."""

from collections.abc import Callable

from services.mde.network import DeviationNetwork
from services.mde.network_crop import CropNetwork
from services.mde.network_paper import PaperNetwork

VARIANTS: dict[str, Callable[..., DeviationNetwork]] = {"crop": CropNetwork, "paper": PaperNetwork}
"""Name on the card -> network."""
