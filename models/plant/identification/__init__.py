"""Identification of a plant: the fit to trials and the comparison with them."""
