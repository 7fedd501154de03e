"""Sources of the goals that the control loop sends."""
