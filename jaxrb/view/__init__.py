"""Floor 8: pictures."""
