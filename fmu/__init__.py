"""FMI export: twin, predictor and observer as FMUs for co-simulation and model exchange."""
