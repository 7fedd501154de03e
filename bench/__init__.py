"""Comparisons with peers and with recordings of other machines."""
