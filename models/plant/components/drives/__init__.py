"""Drives: one file for each, their interface and their registry."""
