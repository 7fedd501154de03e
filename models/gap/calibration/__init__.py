"""Calibration of the gap workflow for your own motions, on drawn rigs."""
