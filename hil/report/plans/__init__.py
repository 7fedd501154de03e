"""Page of plans for the tip that were run on the rig: paths, errors, payloads."""
