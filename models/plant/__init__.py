"""The plant: the reduced, symbolic model that we identify, export and run."""
