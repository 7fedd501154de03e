"""Trials: the file contract, the Deformation Index and importers for other formats."""
