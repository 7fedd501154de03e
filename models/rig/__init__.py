"""Rig: the MuJoCo simulation of the real robot, and the protocol of the study."""
