"""Real time: clocks, timing statistics, doctor checks and notification of systemd."""
