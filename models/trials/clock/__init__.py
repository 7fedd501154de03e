"""Offset between two clocks that recorded the same motion, and the times of a trial's rows."""
