"""Real time: the clock, the timing of a tick, the checks of doctor and the systemd service."""
