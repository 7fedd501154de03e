"""Feedback of the estimated tip: linearised twin, shaped loops, margins, slopes by stiffness."""
