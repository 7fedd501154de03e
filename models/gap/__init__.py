"""The gap between plant and measurement: find it, name what is missing, close it."""
