"""Simulation of a plant: C code from its equations, compiled and run over trials."""
