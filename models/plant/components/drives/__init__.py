"""Drives: one file each, their interface and their registry."""
