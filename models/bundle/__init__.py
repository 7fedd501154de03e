"""Bundle: the directory that `train` writes and the robot loads."""
