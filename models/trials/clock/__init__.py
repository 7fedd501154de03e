"""Offset between two clocks that saw the same motion, and the times of a trial's rows."""
