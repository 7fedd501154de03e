"""Calibration of the gap workflow on rigs for tuning: commands that write its fitted data."""
