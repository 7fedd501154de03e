"""Page of tip plans that were run on the rig: paths, errors, payloads."""
