"""The virtual laboratory: a MuJoCo chain that stands for the real robot, and its protocol."""
