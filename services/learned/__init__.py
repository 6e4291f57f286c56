"""The learned model: a residual encoder-decoder on top of the heuristic sum."""
