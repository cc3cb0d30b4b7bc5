"""Floor 8: measurements of speed."""
