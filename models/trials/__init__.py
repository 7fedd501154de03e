"""Trials: the file contract, the Deformation Index and the importers of other formats."""
