"""Recorded runs of the loop, replayed to check that today's code gives the same goals."""
