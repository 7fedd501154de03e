"""Training of the files that the gap workflow ships, on drawn rigs for tuning."""
