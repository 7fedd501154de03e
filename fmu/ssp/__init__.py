"""SSP package of a system of twin, observer and controller."""
