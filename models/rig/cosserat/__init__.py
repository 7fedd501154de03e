"""Rig on a Cosserat rod: section law, rod, base joints and their coupling to the servos."""
