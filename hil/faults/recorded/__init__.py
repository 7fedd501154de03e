"""Recorded runs: what the loop measured and answered in the past, asked of the code of today."""
