"""Residuals of the twin: parameters to fit, spectra and where the gap is."""
