"""Composition of drive, load and effects into a step model: twin, observer and driven link."""
