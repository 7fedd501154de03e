"""Checks over a whole run: markers, tip, encoder values, phase of joint 2, conditions."""
