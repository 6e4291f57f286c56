"""Training of the learned model."""
