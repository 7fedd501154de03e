"""Calibration of the gap workflow for motions of one's own, on drawn rigs."""
