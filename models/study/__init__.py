"""The published study on a set of trials, and the bundle that is exported from it."""
