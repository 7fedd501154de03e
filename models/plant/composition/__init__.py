"""Composition of drive, load and effects into a model: the twin and the observer."""
