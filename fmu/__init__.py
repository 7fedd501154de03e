"""FMI export: plant and predictor as co-simulation units."""
