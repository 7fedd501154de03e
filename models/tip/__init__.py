"""Tip predictors of the robot: candidates behind one contract, their choice and their interval."""
