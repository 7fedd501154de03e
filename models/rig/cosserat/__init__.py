"""Rig on a Cosserat rod: section law, rod, base joints, and the coupling to the servos."""
