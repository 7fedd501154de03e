"""Host of FMI 3.0 FMUs in plain C, which also runs libraries of other platforms."""
