"""System of twin, observer and controller as an SSP package."""
