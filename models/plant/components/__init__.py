"""Components of a plant: drives, the inflatable link and rigid loads."""
