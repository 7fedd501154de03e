"""Figures that the documentation states, measured by their commands and held to their targets."""
