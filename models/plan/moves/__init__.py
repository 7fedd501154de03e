"""Point-to-point moves: first mode of the link, rate-limited and shaped moves, shortest move."""
