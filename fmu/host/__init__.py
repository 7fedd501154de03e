"""Plain C host of FMI 3.0 FMUs, also for libraries of other platforms."""
