"""The nouns of the problem: heightmaps, scenes, models and their deviations. NumPy only, no input or output."""
