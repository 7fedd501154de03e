"""Checks over a whole run: places of the markers, encoder values, phase of joint 2."""
