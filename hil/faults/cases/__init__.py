"""Cases of the fault campaign: the robot, and a run on each kind of line."""
