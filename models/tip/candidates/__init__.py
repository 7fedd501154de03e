"""Candidates for the robot's tip predictor, one class in one file each."""
