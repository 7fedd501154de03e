"""Forms of a rig's parts: one module for each choice of its structure."""
