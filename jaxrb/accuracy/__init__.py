"""Floor 7: how accurate a run is, and what accuracy costs."""
