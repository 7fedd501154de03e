"""Measurement of the robot's tip predictor behind the servos, on the rig."""
