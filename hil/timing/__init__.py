"""Timing of a run: the verdict, the budget of a tick and what the host did meanwhile."""
