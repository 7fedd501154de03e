"""Offset between two clocks that saw the same motion."""
