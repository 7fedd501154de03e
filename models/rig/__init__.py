"""Rig: the MuJoCo simulation that stands for the real robot, and the study's protocol."""
