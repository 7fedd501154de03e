"""One case of the campaign: its robot, and its run on each kind of line."""
