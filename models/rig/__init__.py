"""Rig: the simulation that stands for the real robot, and the protocol of the study."""
