"""FMI export: plant, predictor and observer as co-simulation FMUs."""
