"""Log of a run: tick ring, telemetry, recorder process, and the files that it writes."""
