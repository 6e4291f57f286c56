"""What all networks share: scaled input channels, weights with a card, a deterministic training loop."""
