"""Measurements of the robot's loop, its bus and its image."""
