"""Cases of the campaign: robot, and run on each kind of line."""
